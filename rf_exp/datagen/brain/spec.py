"""Which RoboBrain, as `conf/brain/<name>.yaml` says.

A specification travels to worker processes; the brain is made there, anew for every episode.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol, cast, runtime_checkable

import dacite

from rf_exp.datagen.brain.faulty import FaultySpec
from rf_exp.datagen.brain.language import OpenAISpec, ReplaySpec
from rf_exp.datagen.brain.protocol import Brain
from rf_exp.datagen.brain.scripted import ScriptedSpec
from rf_exp.errors import ArgumentError, choices
from rf_exp.secrets import no_key_here
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


@runtime_checkable
class BrainSpec(Protocol):
    """What a brain is made from. Implementations are frozen dataclasses."""

    name: ClassVar[str]
    reads: ClassVar[bool]  # title and description of the task, and sees its pictures: they decide its answers

    @property
    def identity(self) -> Mapping[str, object]:
        """What decides the answers, as JSON values: runs that differ here must not be mixed."""
        ...

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> Brain:
        """The brain for one episode. Raises ArgumentError for what this machine lacks."""
        ...

    def again(self) -> "BrainSpec":
        """The specification under which an episode that was made can be made once more, the same."""
        ...


SPECS = {spec.name: spec for spec in (ScriptedSpec, OpenAISpec, ReplaySpec, FaultySpec)}


def read_brain(node: Mapping[str, Any]) -> BrainSpec:
    """The specification in a mapping of plain values. Raises ArgumentError that names the key."""
    options = {key: value for key, value in node.items() if key != "name"}
    name = node.get("name")
    if name not in SPECS:
        raise choices("brain", name, SPECS)
    if "api_key" in options:
        raise no_key_here("api_key")
    config = dacite.Config(strict=True, type_hooks={Path: Path, float: _number})
    try:
        return cast(BrainSpec, dacite.from_dict(SPECS[name], options, config))
    except (dacite.DaciteError, TypeError) as error:
        raise ArgumentError(f"brain {name!r}: {error}") from error


def _number(value: object) -> object:
    """YAML's `1` where `1.0` is meant."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
