"""Names of a package that are imported once they are asked for (PEP 562).

What a command line says is understood without torch and SAPIEN, so a room that has light names beside heavy
ones says where the heavy ones are instead of importing them.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def late(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """`__getattr__` of a package; `modules` is inner module -> the names that it gives."""
    home = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{home[name]}"), name)

    return find
