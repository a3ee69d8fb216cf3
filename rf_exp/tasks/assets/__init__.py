"""Procedural assets: one module a thing, each with a function `build()` returning its `Asset`."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from rf_exp.errors import choices
from rf_exp.tasks.assets.base import Asset, InteractionPoint, Part

__all__ = ["Asset", "InteractionPoint", "Part", "available", "load"]


def available() -> tuple[str, ...]:
    """Names of the assets that exist."""
    return tuple(module.name for module in iter_modules(__path__) if module.name != "base")


@cache
def load(name: str) -> Asset:
    """The asset of that name. Raises ArgumentError for a name that does not exist."""
    if name not in available():
        raise choices("asset", name, available())
    return import_module(f"{__name__}.{name}").build()
