"""Which keys a configuration may have, by the files of `conf/` and the dataclasses that it becomes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, get_args, get_origin, get_type_hints

from rf_exp.datagen.brain import SPECS
from rf_exp.keys.refusal import ALWAYS, content, nearest
from rf_exp.policy import TrainConfig, policy_keys
from rf_exp.tasks import COUNTED, CameraSpec, Task, Variation, is_family
from rf_exp.types import Arch, ConstraintSet

RANDOMISED = ("randomisation",)  # a task has the experiment's, unless it says otherwise

FAMILY = {"arms": dict.fromkeys(COUNTED), "things": dict.fromkeys(COUNTED), "layout": None}


@dataclass(frozen=True)
class Entries:
    """Any names, each with the same keys. An entry without those of `needed` may be another one, misspelt."""

    keys: Mapping[str, Any]
    needed: frozenset[str]
    own: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # name -> keys that differ from `keys`
    whole_by: frozenset[str] = frozenset()  # keys, each of which makes up for those that an entry lacks

    def of(self, name: str) -> Mapping[str, Any]:
        """The keys of an entry."""
        return {**self.keys, **self.own.get(name, {})}

    def whole(self, node: Mapping[str, Any]) -> list[str]:
        """The names of entries that lack nothing."""
        return [
            name
            for name, entry in node.items()
            if isinstance(entry, Mapping) and (self.needed <= set(entry) or self.whole_by & set(entry))
        ]


def known(node: Mapping[str, Any], tasks: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Key -> the keys below it, a mapping, Entries or a list of one of these; anything else: whatever.

    `node`, a configuration, says which brain there is, for its options; `tasks`, what the files of tasks say,
    which thresholds and cameras each has.
    """
    found: dict[str, Any] = {}
    for path in ALWAYS:
        found |= content(path)
    own = {  # what a task's file decides: its thresholds, and its cameras, one for each agent
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
        "training": _fields(TrainConfig, "seed"),  # that is train_seed
        "variation": _fields(Variation),
        "evaluated": _fields(Variation),
        "task": replace(_entries(Task, "variation"), own=own, whole_by=frozenset({"layout"})),
        "arch": _entries(Arch, "name"),
        "constraints": Entries(kinds, frozenset(kinds)),
        # A key in the place of its variable's name is refused later, in words of its own.
        "brain": spec and _fields(spec) | {"name": None, "api_key": None},
    }


def unknown(node: Any, keys: Any, at: str = "") -> Iterator[str]:
    """The dotted keys of a configuration that nobody reads."""
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
    """(dotted key, its value, the keys below it that are expected) of what has a value in their place."""
    if isinstance(node, Mapping) and isinstance(keys, Entries):
        keys = {name: keys.of(name) for name in node}
    for key, below in keys.items() if isinstance(keys, Mapping) else ():
        value = node.get(key) if isinstance(node, Mapping) else None
        if isinstance(value, Mapping):
            yield from flat(value, below, f"{at}{key}.")
        elif isinstance(below, Mapping) and below and isinstance(node, Mapping) and key in node:
            yield f"{at}{key}", value, below


def absent(node: Mapping[str, Any], content: Mapping[str, Any], at: str = "") -> Iterator[str]:
    """The dotted keys of a file that a configuration lacks, without those below them."""
    for key, below in content.items():
        if key not in node:
            yield f"{at}{key}"
        elif isinstance(below, Mapping) and isinstance(node[key], Mapping):
            yield from absent(node[key], below, f"{at}{key}.")


def possible(node: Any, keys: Any, at: str = "") -> Iterator[str]:
    """The dotted keys that a configuration may have; of entries, those that are there."""
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
