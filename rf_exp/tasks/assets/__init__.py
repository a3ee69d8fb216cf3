"""Procedural assets: one module a thing, each with a function `build(...)` returning its `Asset`.

A user's own mesh comes in through its annotation file, see `rf_exp.tasks.assets.asset.mesh`, and what a
person has of the authors' release through the files of that, see `rf_exp.tasks.assets.asset.annotated`.
"""

from collections.abc import Mapping
from functools import cache, partial
from importlib import import_module
from pkgutil import iter_modules

from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks.assets.asset.base import Asset, Colour, Hinge, InteractionPoint, Part, convex_pieces
from rf_exp.tasks.assets.asset.released import released, seat_m

__all__ = [
    "Asset",
    "Colour",
    "Hinge",
    "InteractionPoint",
    "Part",
    "available",
    "convex_pieces",
    "load",
    "released",
    "seat_m",
]

_MACHINERY = ("__main__", "asset")


def available() -> tuple[str, ...]:
    """Names of the assets that exist."""
    return tuple(module.name for module in iter_modules(__path__) if module.name not in _MACHINERY)


def load(name: str, options: Mapping[str, object] | None = None) -> Asset:
    """The asset of that name, built with `options`; always the same object for the same arguments.

    The name of a module here, the full name of another module with a function `build(...)`, or the
    path of an annotation file (.yaml) of a mesh; a path counts from the current folder.
    Raises ArgumentError for a name that does not exist and for options that it does not take.
    """
    return _load(name, tuple(sorted(options.items())) if options else ())


@cache
def _load(name: str, options: tuple[tuple[str, object], ...]) -> Asset:
    if name.endswith((".yaml", ".yml")):
        build = partial(import_module(f"{__name__}.asset.mesh").build, name)
    elif "." not in name and name not in available():
        raise choices("asset", name, available())
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
