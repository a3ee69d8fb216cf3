"""Families of tasks: a module each, for any number of arms and things."""
