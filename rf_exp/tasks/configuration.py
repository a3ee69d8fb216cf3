"""Turns the configuration of a task, as plain values, into a checked Task."""

from collections.abc import Mapping

import dacite

from rf_exp.errors import ArgumentError
from rf_exp.tasks.base import Task


def _range(value: object) -> object:
    """A single number is a range without width."""
    return [float(value), float(value)] if isinstance(value, int | float) else value


_CONFIG = dacite.Config(cast=[tuple], strict=True, type_hooks={tuple[float, float]: _range})


def load_task(name: str, node: Mapping) -> Task:
    """The Task of `conf/task/<name>.yaml`'s mapping below the key `<name>`, as plain Python values.

    Raises ArgumentError naming the field for what is missing, unknown, or of another type, for an
    asset that does not exist, and for an object that stands on one not listed before it.
    """
    try:
        task = dacite.from_dict(Task, dict(node), config=_CONFIG)
    except dacite.UnexpectedDataError as error:
        unknown = ", ".join(sorted(map(str, error.keys)))
        raise ArgumentError(f"task {name!r}: unknown field {unknown}") from error
    except dacite.MissingValueError as error:
        raise ArgumentError(f"task {name!r}: field {error.field_path} is missing") from error
    except dacite.WrongTypeError as error:
        raise ArgumentError(
            f"task {name!r}: field {error.field_path} is {error.value!r}; expected {error.field_type}"
        ) from error
    except ArgumentError as error:
        raise ArgumentError(f"task {name!r}: {error}") from error
    if task.name != name:
        raise ArgumentError(f"task {name!r}: field name is {task.name!r}; expected {name!r}")
    if task.cameras["global"].mount == "wrist":
        raise ArgumentError(
            f"task {name!r}: camera 'global' has mount 'wrist'; expected 'world': it belongs to no arm"
        )
    seen: list[str] = []
    for key, spec in task.objects.items():
        try:
            task.asset(key)
        except ArgumentError as error:
            raise ArgumentError(f"task {name!r}: object {key!r}: {error}") from error
        if spec.relative_to is not None and spec.relative_to not in seen:
            raise ArgumentError(
                f"task {name!r}: object {key!r} is relative to {spec.relative_to!r}; "
                f"expected one listed before it: {seen}"
            )
        seen.append(key)
    return task
