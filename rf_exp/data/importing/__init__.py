"""Import of other data sets into stores: a source is surveyed before anything is copied."""

from rf_exp.data.importing.importer import import_demonstrations

__all__ = ["import_demonstrations"]
