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
from rf_exp.command import guarded
from rf_exp.compose.composing import Composed, compose, written
from rf_exp.compose.wording import worded
from rf_exp.datagen.brain import BrainSpec, OpenAIChat, OpenAISpec, ScriptedSpec, read_brain
from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.installed import CONF
from rf_exp.progress import console
from rf_exp.tasks import Task, load_task
from rf_exp.texts import LONGEST_LINE, one_line
from rf_exp.types import NO_PICTURES, ConstraintSet

KEYS = {"objects": None, "name": "composed", "out": "composed", "episodes": 3, "brain": None}
BRAINS = ("openai",)


def main() -> None:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m rf_exp.compose", description=__doc__, formatter_class=raw)
    parser.add_argument("sentence")
    parser.add_argument("keys", nargs="*", metavar="KEY=VALUE")
    said = parser.parse_args()
    given = _read(said.sentence, said.keys)
    folder = Path(given["out"])
    code = ".".join((*folder.parts, given["name"]))
    composed = _composed(said.sentence, given, code)
    config, module = written(composed, folder)
    console.print(
        f"{len(composed.said.jobs)} jobs for {composed.said.arms} arms; wrote {config} and {module}"
    )
    sys.path.insert(0, str(Path.cwd()))
    task = load_task(composed.name, composed.node)
    broken = _laws(task)
    failed = _expert(task, int(given["episodes"]))
    search = f'"hydra.searchpath=[file://$PWD/{folder}/conf]"'
    console.print(f"next: python -m rf_exp.gallery {search} task={composed.name}")
    if broken or failed:
        raise StageError(f"{broken} laws are broken, {failed} scenes failed; where and why is said above")


def _composed(text: str, given: dict[str, Any], code: str) -> Composed:
    """The task of a sentence as it is written, or as a model rewords it."""

    def make(sentence: str) -> Composed:
        return compose(sentence, given["objects"], given["name"], code)

    if given["brain"] is None:
        return make(text)
    composed = worded(text, given["objects"], OpenAIChat(given["brain"], None), make)
    console.print(f"understood as: {composed.text}")
    return composed


def _brain(name: str, options: dict[str, Any]) -> OpenAISpec:
    """Specification of the rewording model, from its keys. Raises ArgumentError for other brains and keys."""
    if name not in BRAINS:
        raise choices("brain", name, BRAINS)
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "brain" / f"{name}.yaml"), resolve=False)
    spec: BrainSpec = read_brain({**node, "exchanges": None, **options})
    assert isinstance(spec, OpenAISpec)
    return spec


def _read(text: str, keys: list[str]) -> dict[str, Any]:
    """The values of all keys. Raises ArgumentError for a key in place of the sentence and for wrong keys."""
    for each in (text, *keys):
        if ("=" in each.split(" ")[0]) == (each is text):
            raise ArgumentError(
                f"{each!r}: expected one sentence, in quotes, then keys as KEY=VALUE: {', '.join(KEYS)}"
            )
    of_model = [key.removeprefix("brain.") for key in keys if key.startswith("brain.")]
    try:
        said: Any = OmegaConf.to_container(
            OmegaConf.from_dotlist([key for key in keys if not key.startswith("brain.")])
        )
        options: Any = OmegaConf.to_container(OmegaConf.from_dotlist(of_model))
    except (OmegaConfBaseException, YAMLError) as error:
        raise ArgumentError(f"cannot read {' '.join(keys)}: {one_line(str(error), LONGEST_LINE)}") from error
    for key in said:
        if key not in KEYS:
            raise choices("key", key, KEYS)
    given = KEYS | said
    if not isinstance(given["objects"], list):
        raise ArgumentError(
            f"objects is {given['objects']!r}; expected a list, as objects=[cube,cube,bowl:pot]"
        )
    if not isinstance(given["name"], str):
        raise ArgumentError(f"name is {given['name']!r}; expected small letters, digits and _")
    folder = Path(given["out"]) if isinstance(given["out"], str) else Path("/")
    if folder.is_absolute() or not folder.parts or not all(part.isidentifier() for part in folder.parts):
        raise ArgumentError(f"out is {given['out']!r}; expected a folder below this one, as my_tasks")
    there = find_spec(folder.parts[0])  # a module that would hide the written one
    if there is not None and Path.cwd() not in Path(there.origin or Path.cwd() / "here").parents:
        raise ArgumentError(
            f"out is {given['out']!r}, and {folder.parts[0]!r} is a module of Python's; choose another"
        )
    if type(given["episodes"]) is not int or given["episodes"] < 0:
        raise ArgumentError(f"episodes is {given['episodes']!r}; expected 0 or more")
    if of_model and given["brain"] is None:
        raise ArgumentError(f"brain.{of_model[0]} is of a language model; say brain=openai as well")
    return given if given["brain"] is None else {**given, "brain": _brain(given["brain"], options)}


def _laws(task: Task) -> int:
    broken = 0
    for law, found in laws.judged(task):
        broken += bool(found)
        console.print(f"{law.says}: {'holds' if not found else '; '.join(found)}")
    return broken


def _expert(task: Task, episodes: int) -> int:
    settings = datagen.Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    failed = 0
    for seed in range(episodes):
        outcome = datagen.make_episode(settings, NO_PICTURES, seed)
        failed += not outcome.success
        how = f"success in {outcome.steps} steps" if outcome.success else f"failed: {outcome.reason}"
        console.print(f"seed {seed}: {how}, {outcome.contacts} contacts")
    return failed


if __name__ == "__main__":
    sys.exit(guarded(main))
