"""Demonstrations of others as stores: what a file holds, surveyed before anything is copied; and the copy."""

from rf_exp.data.importing.taking import import_demonstrations

__all__ = ["import_demonstrations"]
