"""Factory: creates a policy by a user's Python function, which is named on the command line.

Depends on nothing of the suite but its errors, so that a server can use it where nothing else is installed.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rf_exp.errors import ArgumentError, StageError


def make_policy(name: str, options: Mapping[str, Any] | None = None) -> Any:
    """The result of factory `package.module:function` for these keyword arguments: an object with `act`.

    Raises ArgumentError for a name that cannot be resolved, StageError for a factory that raises or returns
    something else.
    """
    module, _, function = name.partition(":")
    try:
        imported = import_module(module)
    except Exception as error:  # an import may raise anything
        raise ArgumentError(
            f"factory {name!r}: {module!r} cannot be imported: {type(error).__name__}: {error}; expected "
            "package.module:function of a module that Python finds, in this folder or by PYTHONPATH"
        ) from error
    factory = getattr(imported, function, None)
    if not callable(factory):
        known = [key for key, value in vars(imported).items() if callable(value) and not key.startswith("_")]
        raise ArgumentError(
            f"factory {name!r}: {module!r} has no function {function!r}; it has {', '.join(known) or 'none'}"
        )
    try:
        policy = factory(**(options or {}))
    except Exception as error:
        raise StageError(f"factory {name!r} raised {type(error).__name__}: {error}") from error
    if not callable(getattr(policy, "act", None)):
        raise StageError(
            f"factory {name!r} returned a {type(policy).__name__} without act(observation); expected an "
            "object with it, and with reset(seed) where it remembers anything"
        )
    return policy
