"""Families of tasks, one module each, for any number of arms and objects."""
