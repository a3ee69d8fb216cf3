"""RoboBrain: proposes subgoals and textual constraints."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import dacite

from rf_exp.datagen.brain.chat import Chat, Message, OpenAIChat, probe
from rf_exp.datagen.brain.faults import FAULTS
from rf_exp.datagen.brain.language import LanguageBrain, OpenAISpec, ReplaySpec, bullet_list, fill_prompt
from rf_exp.datagen.brain.legal import legal_answers
from rf_exp.datagen.brain.protocol import (
    BadAnswer,
    Brain,
    BrainSpec,
    Question,
    from_json,
    read_object,
    to_json,
)
from rf_exp.datagen.brain.scripted import (
    FaultyBrain,
    FaultySpec,
    RandomSpec,
    ScriptedBrain,
    ScriptedSpec,
    fault_applies,
    faults_for,
)
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.secrets import key_in_config_error

__all__ = [
    "FAULTS",
    "SPECS",
    "BadAnswer",
    "Brain",
    "BrainSpec",
    "Chat",
    "FaultyBrain",
    "FaultySpec",
    "LanguageBrain",
    "Message",
    "OpenAIChat",
    "OpenAISpec",
    "Question",
    "RandomSpec",
    "ReplaySpec",
    "ScriptedBrain",
    "ScriptedSpec",
    "bullet_list",
    "fault_applies",
    "faults_for",
    "fill_prompt",
    "from_json",
    "legal_answers",
    "probe",
    "read_brain",
    "read_object",
    "to_json",
]

SPECS = {spec.name: spec for spec in (ScriptedSpec, OpenAISpec, ReplaySpec, FaultySpec, RandomSpec)}


def read_brain(node: Mapping[str, Any]) -> BrainSpec:
    """The brain specification in a mapping of plain values. Raises ArgumentError that names the key."""
    options = {key: value for key, value in node.items() if key != "name"}
    name = node.get("name")
    if name not in SPECS:
        raise unknown_choice("brain", name, SPECS)
    if "api_key" in options:
        raise key_in_config_error("api_key")
    config = dacite.Config(strict=True, type_hooks={Path: Path, float: _number})
    try:
        return cast(BrainSpec, dacite.from_dict(SPECS[name], options, config))
    except (dacite.DaciteError, TypeError) as error:
        raise ArgumentError(f"brain {name!r}: {error}") from error


def _number(value: object) -> object:
    """Converts YAML's `1` where `1.0` is meant."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
