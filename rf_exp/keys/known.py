"""Known configuration keys, from the files of `conf/` and the dataclasses that it becomes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from typing import Any, get_args, get_origin, get_type_hints

from rf_exp.datagen.brain import SPECS
from rf_exp.keys.refusal import BASE_FILES, config_content, nearest
from rf_exp.policy import TrainConfig, policy_keys
from rf_exp.tasks import COUNT_FIELDS, CameraSpec, Task, Variation, is_family
from rf_exp.types import Arch, ConstraintSet

OPTIONAL_TASK_KEYS = ("randomisation",)  # keys of a task that default to those of the experiment

FAMILY = {"arms": dict.fromkeys(COUNT_FIELDS), "things": dict.fromkeys(COUNT_FIELDS), "layout": None}


@dataclass(frozen=True)
class Entries:
    """A mapping of any names, each with the same keys. An entry without the `needed` ones may be misspelt."""

    keys: Mapping[str, Any]
    needed: frozenset[str]
    own: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # name -> keys that differ from `keys`
    replacing_needed: frozenset[str] = frozenset()  # keys, any of which replaces the needed ones

    def entry_keys(self, name: str) -> Mapping[str, Any]:
        """The keys of an entry."""
        return {**self.keys, **self.own.get(name, {})}

    def complete_names(self, node: Mapping[str, Any]) -> list[str]:
        """The names of complete entries."""
        return [
            name
            for name, entry in node.items()
            if isinstance(entry, Mapping)
            and (self.needed <= set(entry) or self.replacing_needed & set(entry))
        ]


def known_keys(node: Mapping[str, Any], tasks: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Key -> keys below it: a mapping, Entries or a list of one of these; anything else allows any value.

    `node`, a configuration, names the brain, which decides its options; `tasks`, the content of task files,
    has the thresholds and cameras of each task.
    """
    always: dict[str, Any] = {}
    for path in BASE_FILES:
        always |= config_content(path)
    own = {  # from the task's file: its thresholds, and its cameras, one for each agent
        name: {
            "success": dict.fromkeys(task.get("success", ())),
            "cameras": dict.fromkeys(task.get("cameras", ()), _field_keys(CameraSpec)),
            **(FAMILY if is_family(task) else {}),
        }
        for name, task in tasks.items()
    }
    kinds = _field_keys(ConstraintSet, "name")
    brain = node.get("brain")
    spec = SPECS.get(str(brain.get("name"))) if isinstance(brain, Mapping) else None
    return always | {
        "policy": policy_keys(),
        "training": _field_keys(TrainConfig, "seed"),  # set by train_seed
        "variation": _field_keys(Variation),
        "evaluated": _field_keys(Variation),
        "task": replace(_entries(Task, "variation"), own=own, replacing_needed=frozenset({"layout"})),
        "arch": _entries(Arch, "name"),
        "constraints": Entries(kinds, frozenset(kinds)),
        # An API key in place of the name of its variable is refused later, with a message of its own.
        "brain": spec and _field_keys(spec) | {"name": None, "api_key": None},
    }


def unknown_keys(node: Any, keys: Any, prefix: str = "") -> Iterator[str]:
    """Yields the unknown keys of a configuration, dotted."""
    if isinstance(keys, list) and isinstance(node, list):
        for index, each in enumerate(node):
            yield from unknown_keys(each, keys[0], f"{prefix}{index}.")
    if not isinstance(node, Mapping) or not isinstance(keys, Mapping | Entries) or not keys:
        return
    if isinstance(keys, Entries):
        complete = keys.complete_names(node)
        keys = {
            name: keys.entry_keys(name)
            for name in node
            if name in complete or not nearest(str(name), complete)
        }
    for key, value in node.items():
        if key in keys:
            yield from unknown_keys(value, keys[key], f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def replaced_mappings(node: Any, keys: Any, prefix: str = "") -> Iterator[tuple[str, Any, Iterable[str]]]:
    """Yields (dotted key, its value, expected keys below it) where a value replaces a mapping."""
    if isinstance(node, Mapping) and isinstance(keys, Entries):
        keys = {name: keys.entry_keys(name) for name in node}
    for key, below in keys.items() if isinstance(keys, Mapping) else ():
        value = node.get(key) if isinstance(node, Mapping) else None
        if isinstance(value, Mapping):
            yield from replaced_mappings(value, below, f"{prefix}{key}.")
        elif isinstance(below, Mapping) and below and isinstance(node, Mapping) and key in node:
            yield f"{prefix}{key}", value, below


def missing_keys(
    node: Mapping[str, Any], config_content: Mapping[str, Any], prefix: str = ""
) -> Iterator[str]:
    """Yields the dotted keys of a file that a configuration lacks, without those below them."""
    for key, below in config_content.items():
        if key not in node:
            yield f"{prefix}{key}"
        elif isinstance(below, Mapping) and isinstance(node[key], Mapping):
            yield from missing_keys(node[key], below, f"{prefix}{key}.")


def possible_keys(node: Any, keys: Any, prefix: str = "") -> Iterator[str]:
    """Yields the dotted keys that a configuration may have; for Entries, those of the entries that it has."""
    present = node if isinstance(node, Mapping) else {}
    if isinstance(keys, list) and isinstance(node, list):
        present, keys = dict(enumerate(node)), dict.fromkeys(range(len(node)), keys[0])
    elif isinstance(keys, Entries):
        keys = {name: keys.entry_keys(name) for name in keys.complete_names(present)}
    for key, below in keys.items() if isinstance(keys, Mapping) else ():
        yield f"{prefix}{key}"
        yield from possible_keys(present.get(key), below, f"{prefix}{key}.")


def _field_keys(kind: Any, *without: str) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {each.name: _nested_keys(hints[each.name]) for each in fields(kind) if each.name not in without}


def _entries(kind: Any, *without: str) -> Entries:
    needed = {each.name for each in fields(kind) if each.default is each.default_factory is MISSING}
    return Entries(_field_keys(kind, *without), frozenset(needed.difference(without, OPTIONAL_TASK_KEYS)))


def _nested_keys(kind: Any) -> Any:
    arguments = get_args(kind)
    if is_dataclass(kind):
        return _field_keys(kind)
    if get_origin(kind) is Mapping and is_dataclass(arguments[1]):
        return _entries(arguments[1])
    if get_origin(kind) is tuple and is_dataclass(arguments[0]):
        return [_field_keys(arguments[0])]
    return None
