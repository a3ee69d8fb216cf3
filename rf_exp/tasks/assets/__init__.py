"""Procedural assets: one module per asset, each with a function `build(...)` that returns an `Asset`.

A user's own mesh is loaded through its annotation file, see `rf_exp.tasks.assets.asset.mesh`, and an asset of
the authors' release from a local copy of its files, see `rf_exp.tasks.assets.asset.annotated`.
"""

from collections.abc import Mapping
from functools import cache, partial
from importlib import import_module
from pkgutil import iter_modules

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.tasks.assets.asset.base import Asset, Colour, Hinge, InteractionPoint, Part, convex_pieces
from rf_exp.tasks.assets.asset.released import release_sources, seat_m

__all__ = [
    "Asset",
    "Colour",
    "Hinge",
    "InteractionPoint",
    "Part",
    "available",
    "convex_pieces",
    "load",
    "release_sources",
    "seat_m",
]

_NOT_ASSETS = ("__main__", "asset")


def available() -> tuple[str, ...]:
    """Names of the built-in assets."""
    return tuple(module.name for module in iter_modules(__path__) if module.name not in _NOT_ASSETS)


def load(name: str, options: Mapping[str, object] | None = None) -> Asset:
    """The asset of a name, built with `options`; the same instance for the same arguments.

    `name` is a module of this package, the full name of another module with a function `build(...)`, or the
    path of a mesh's annotation file (.yaml), relative to the current folder.
    Raises ArgumentError for a name that does not exist and for unknown options.
    """
    return _load(name, tuple(sorted(options.items())) if options else ())


@cache
def _load(name: str, options: tuple[tuple[str, object], ...]) -> Asset:
    if name.endswith((".yaml", ".yml")):
        build = partial(import_module(f"{__name__}.asset.mesh").build, name)
    elif "." not in name and name not in available():
        raise unknown_choice("asset", name, available())
    else:
        try:
            build = import_module(name if "." in name else f"{__name__}.{name}").build
        except ModuleNotFoundError as error:
            raise ArgumentError(
                f"asset {name!r}: {error}; available here: {', '.join(available())}"
            ) from error
    try:
        return build(**dict(options))
    except TypeError as error:
        raise ArgumentError(f"asset {name!r} with options {dict(options)}: {error}") from error
