"""Factory: a policy made by somebody's Python function, which the person names on the command line.

Needs nothing of the suite but its errors, so that a server can use it where nothing else is installed.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rf_exp.errors import ArgumentError, StageError


def make_policy(name: str, options: Mapping[str, Any] | None = None) -> Any:
    """What the factory `package.module:function` returns for these keyword arguments: something with `act`.

    Raises ArgumentError for a name that leads nowhere, StageError for a factory that raises or returns
    something else.
    """
    module, _, function = name.partition(":")
    try:
        found = import_module(module)
    except Exception as error:  # whatever a module does when it is imported
        raise ArgumentError(
            f"factory {name!r}: {module!r} cannot be imported: {type(error).__name__}: {error}; expected "
            "package.module:function of a module that Python finds, in this folder or by PYTHONPATH"
        ) from error
    factory = getattr(found, function, None)
    if not callable(factory):
        there = [key for key, each in vars(found).items() if callable(each) and not key.startswith("_")]
        raise ArgumentError(
            f"factory {name!r}: {module!r} has no function {function!r}; it has {', '.join(there) or 'none'}"
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
