"""Known configuration keys, from the files of `conf/` and the dataclasses that it becomes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, get_args, get_origin, get_type_hints

from rf_exp.datagen.brain import SPECS
from rf_exp.keys.refusal import ALWAYS, content, nearest
from rf_exp.policy import TrainConfig, policy_keys
from rf_exp.tasks import COUNTED, CameraSpec, Task, Variation, is_family
from rf_exp.types import Arch, ConstraintSet

RANDOMISED = ("randomisation",)  # keys of a task that default to those of the experiment

FAMILY = {"arms": dict.fromkeys(COUNTED), "things": dict.fromkeys(COUNTED), "layout": None}


@dataclass(frozen=True)
class Entries:
    """A mapping of any names, each with the same keys. An entry without the `needed` ones may be misspelt."""

    keys: Mapping[str, Any]
    needed: frozenset[str]
    own: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # name -> keys that differ from `keys`
    whole_by: frozenset[str] = frozenset()  # keys, any of which replaces the needed ones

    def of(self, name: str) -> Mapping[str, Any]:
        """The keys of an entry."""
        return {**self.keys, **self.own.get(name, {})}

    def whole(self, node: Mapping[str, Any]) -> list[str]:
        """The names of complete entries."""
        return [
            name
            for name, entry in node.items()
            if isinstance(entry, Mapping) and (self.needed <= set(entry) or self.whole_by & set(entry))
        ]


def known(node: Mapping[str, Any], tasks: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Key -> keys below it: a mapping, Entries or a list of one of these; anything else allows any value.

    `node`, a configuration, names the brain, which decides its options; `tasks`, the content of task files,
    has the thresholds and cameras of each task.
    """
    found: dict[str, Any] = {}
    for path in ALWAYS:
        found |= content(path)
    own = {  # from the task's file: its thresholds, and its cameras, one for each agent
        name: {
            "success": dict.fromkeys(task.get("success", ())),
            "cameras": dict.fromkeys(task.get("cameras", ()), _fields(CameraSpec)),
            **(FAMILY if is_family(task) else {}),
        }
        for name, task in tasks.items()
    }
    kinds = _fields(ConstraintSet, "name")
    brain = node.get("brain")
    spec = SPECS.get(str(brain.get("name"))) if isinstance(brain, Mapping) else None
    return found | {
        "policy": policy_keys(),
        "training": _fields(TrainConfig, "seed"),  # set by train_seed
        "variation": _fields(Variation),
        "evaluated": _fields(Variation),
        "task": replace(_entries(Task, "variation"), own=own, whole_by=frozenset({"layout"})),
        "arch": _entries(Arch, "name"),
        "constraints": Entries(kinds, frozenset(kinds)),
        # An API key in place of the name of its variable is refused later, with a message of its own.
        "brain": spec and _fields(spec) | {"name": None, "api_key": None},
    }


def unknown(node: Any, keys: Any, at: str = "") -> Iterator[str]:
    """Yields the unknown keys of a configuration, dotted."""
    if isinstance(keys, list) and isinstance(node, list):
        for index, each in enumerate(node):
            yield from unknown(each, keys[0], f"{at}{index}.")
    if not isinstance(node, Mapping) or not isinstance(keys, Mapping | Entries) or not keys:
        return
    if isinstance(keys, Entries):
        whole = keys.whole(node)
        keys = {name: keys.of(name) for name in node if name in whole or not nearest(str(name), whole)}
    for key, value in node.items():
        if key in keys:
            yield from unknown(value, keys[key], f"{at}{key}.")
        else:
            yield f"{at}{key}"


def flat(node: Any, keys: Any, at: str = "") -> Iterator[tuple[str, Any, Iterable[str]]]:
    """Yields (dotted key, its value, expected keys below it) where a value replaces a mapping."""
    if isinstance(node, Mapping) and isinstance(keys, Entries):
        keys = {name: keys.of(name) for name in node}
    for key, below in keys.items() if isinstance(keys, Mapping) else ():
        value = node.get(key) if isinstance(node, Mapping) else None
        if isinstance(value, Mapping):
            yield from flat(value, below, f"{at}{key}.")
        elif isinstance(below, Mapping) and below and isinstance(node, Mapping) and key in node:
            yield f"{at}{key}", value, below


def absent(node: Mapping[str, Any], content: Mapping[str, Any], at: str = "") -> Iterator[str]:
    """Yields the dotted keys of a file that a configuration lacks, without those below them."""
    for key, below in content.items():
        if key not in node:
            yield f"{at}{key}"
        elif isinstance(below, Mapping) and isinstance(node[key], Mapping):
            yield from absent(node[key], below, f"{at}{key}.")


def possible(node: Any, keys: Any, at: str = "") -> Iterator[str]:
    """Yields the dotted keys that a configuration may have; for Entries, those of the entries that it has."""
    there = node if isinstance(node, Mapping) else {}
    if isinstance(keys, list) and isinstance(node, list):
        there, keys = dict(enumerate(node)), dict.fromkeys(range(len(node)), keys[0])
    elif isinstance(keys, Entries):
        keys = {name: keys.of(name) for name in keys.whole(there)}
    for key, below in keys.items() if isinstance(keys, Mapping) else ():
        yield f"{at}{key}"
        yield from possible(there.get(key), below, f"{at}{key}.")


def _fields(kind: Any, *without: str) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {each.name: _below(hints[each.name]) for each in fields(kind) if each.name not in without}


def _entries(kind: Any, *without: str) -> Entries:
    needed = {each.name for each in fields(kind) if each.default is each.default_factory is MISSING}
    return Entries(_fields(kind, *without), frozenset(needed.difference(without, RANDOMISED)))


def _below(kind: Any) -> Any:
    arguments = get_args(kind)
    if is_dataclass(kind):
        return _fields(kind)
    if get_origin(kind) is Mapping and is_dataclass(arguments[1]):
        return _entries(arguments[1])
    if get_origin(kind) is tuple and is_dataclass(arguments[0]):
        return [_fields(arguments[0])]
    return None
