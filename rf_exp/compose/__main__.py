"""Composes a task from a sentence: writes its YAML file and its module, and checks the laws of the suite.

python -m rf_exp.compose "two arms put both cubes into the bowl, the lid goes on last" \\
    objects=[cube,cube,bowl:pot,lid] name=both_in

SENTENCE        what is put where; docs/compose.md has the forms
objects=[...]   objects on the table: an asset as `cube`, `red_cube`, or `bowl:pot` with another name
name=NAME       of the task; composed unless given
out=FOLDER      below the current folder, for both files; composed unless given
episodes=N      scenes in which the expert is tried; 3 unless given, 0 for none
brain=openai    a language model rewords the sentence in those forms: `brain.model`, `brain.base_url` and
                the other keys of conf/brain/openai.yaml choose it
"""

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from rf_exp import datagen, laws
from rf_exp.command import run_guarded
from rf_exp.compose.composing import Composed, compose, write_files
from rf_exp.compose.wording import reword
from rf_exp.datagen.brain import BrainSpec, OpenAIChat, OpenAISpec, ScriptedSpec, read_brain
from rf_exp.errors import ArgumentError, StageError, unknown_choice
from rf_exp.installed import CONF
from rf_exp.progress import console
from rf_exp.tasks import Task, load_task
from rf_exp.texts import LONGEST_LINE, one_line
from rf_exp.types import NO_PICTURES, ConstraintSet

KEYS = {"objects": None, "name": "composed", "out": "composed", "episodes": 3, "brain": None}
BRAINS = ("openai",)


def main() -> None:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        "python -m rf_exp.compose", description=__doc__, formatter_class=formatter
    )
    parser.add_argument("sentence")
    parser.add_argument("keys", nargs="*", metavar="KEY=VALUE")
    args = parser.parse_args()
    values = _parse_keys(args.sentence, args.keys)
    folder = Path(values["out"])
    module_name = ".".join((*folder.parts, values["name"]))
    composed = _compose_task(args.sentence, values, module_name)
    config, module = write_files(composed, folder)
    console.print(
        f"{len(composed.parsed.jobs)} jobs for {composed.parsed.arms} arms; wrote {config} and {module}"
    )
    sys.path.insert(0, str(Path.cwd()))
    task = load_task(composed.name, composed.node)
    broken_laws = _check_laws(task)
    failed_scenes = _try_expert(task, int(values["episodes"]))
    search = f'"hydra.searchpath=[file://$PWD/{folder}/conf]"'
    console.print(f"next: python -m rf_exp.gallery {search} task={composed.name}")
    if broken_laws or failed_scenes:
        raise StageError(
            f"{broken_laws} laws are broken, {failed_scenes} scenes failed; where and why is said above"
        )


def _compose_task(text: str, values: dict[str, Any], module_name: str) -> Composed:
    """The task of a sentence as it is written, or as a model rewords it."""

    def compose_sentence(sentence: str) -> Composed:
        return compose(sentence, values["objects"], values["name"], module_name)

    if values["brain"] is None:
        return compose_sentence(text)
    composed = reword(text, values["objects"], OpenAIChat(values["brain"], None), compose_sentence)
    console.print(f"understood as: {composed.text}")
    return composed


def _brain_spec(name: str, options: dict[str, Any]) -> OpenAISpec:
    """Specification of the rewording model, from its keys. Raises ArgumentError for other brains and keys."""
    if name not in BRAINS:
        raise unknown_choice("brain", name, BRAINS)
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "brain" / f"{name}.yaml"), resolve=False)
    spec: BrainSpec = read_brain({**node, "exchanges": None, **options})
    assert isinstance(spec, OpenAISpec)
    return spec


def _parse_keys(text: str, keys: list[str]) -> dict[str, Any]:
    """The values of all keys. Raises ArgumentError for a key in place of the sentence and for wrong keys."""
    for argument in (text, *keys):
        if ("=" in argument.split(" ")[0]) == (argument is text):
            raise ArgumentError(
                f"{argument!r}: expected one sentence, in quotes, then keys as KEY=VALUE: {', '.join(KEYS)}"
            )
    brain_keys = [key.removeprefix("brain.") for key in keys if key.startswith("brain.")]
    try:
        overrides: Any = OmegaConf.to_container(
            OmegaConf.from_dotlist([key for key in keys if not key.startswith("brain.")])
        )
        options: Any = OmegaConf.to_container(OmegaConf.from_dotlist(brain_keys))
    except (OmegaConfBaseException, YAMLError) as error:
        raise ArgumentError(f"cannot read {' '.join(keys)}: {one_line(str(error), LONGEST_LINE)}") from error
    for key in overrides:
        if key not in KEYS:
            raise unknown_choice("key", key, KEYS)
    values = KEYS | overrides
    if not isinstance(values["objects"], list):
        raise ArgumentError(
            f"objects is {values['objects']!r}; expected a list, as objects=[cube,cube,bowl:pot]"
        )
    if not isinstance(values["name"], str):
        raise ArgumentError(f"name is {values['name']!r}; expected small letters, digits and _")
    folder = Path(values["out"]) if isinstance(values["out"], str) else Path("/")
    if folder.is_absolute() or not folder.parts or not all(part.isidentifier() for part in folder.parts):
        raise ArgumentError(f"out is {values['out']!r}; expected a folder below this one, as my_tasks")
    top_module = find_spec(folder.parts[0])  # a module that would hide the written one
    if top_module is not None and Path.cwd() not in Path(top_module.origin or Path.cwd() / "here").parents:
        raise ArgumentError(
            f"out is {values['out']!r}, and {folder.parts[0]!r} is a module of Python's; choose another"
        )
    if type(values["episodes"]) is not int or values["episodes"] < 0:
        raise ArgumentError(f"episodes is {values['episodes']!r}; expected 0 or more")
    if brain_keys and values["brain"] is None:
        raise ArgumentError(f"brain.{brain_keys[0]} is of a language model; say brain=openai as well")
    return values if values["brain"] is None else {**values, "brain": _brain_spec(values["brain"], options)}


def _check_laws(task: Task) -> int:
    broken_laws = 0
    for law, violations in laws.check_task(task):
        broken_laws += bool(violations)
        console.print(f"{law.sentence}: {'holds' if not violations else '; '.join(violations)}")
    return broken_laws


def _try_expert(task: Task, episodes: int) -> int:
    settings = datagen.Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    failed_scenes = 0
    for seed in range(episodes):
        outcome = datagen.make_episode(settings, NO_PICTURES, seed)
        failed_scenes += not outcome.success
        result = f"success in {outcome.steps} steps" if outcome.success else f"failed: {outcome.reason}"
        console.print(f"seed {seed}: {result}, {outcome.contacts} contacts")
    return failed_scenes


if __name__ == "__main__":
    sys.exit(run_guarded(main))
