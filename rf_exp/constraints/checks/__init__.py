"""The checks, a file for each kind under the name of its statement: compiled, planned, measured, in STL."""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):  # a kind is known by being defined
    import_module(f"{__name__}.{_module.name}")
