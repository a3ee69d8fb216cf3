"""Checks, one file per kind, named as its statement: compilation, planned and measured verdicts, STL form."""

from importlib import import_module
from pkgutil import iter_modules

for _module in iter_modules(__path__):  # a kind is registered when it is defined
    import_module(f"{__name__}.{_module.name}")
