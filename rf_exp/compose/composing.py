"""The files of a task that is composed from a sentence and objects."""

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from rf_exp.artifacts import write_text
from rf_exp.compose.layout import lay_out
from rf_exp.compose.sentence import Sentence, read
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.installed import CONF
from rf_exp.tasks import assets
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.shared import circle

SUCCESS = {
    "beside_m": 0.02,  # of an object from its place
    "above_m": 0.006,
    "upright_deg": 10.0,
    "still_m_s": 0.05,
    "hold_steps": 5,
}
VARIANTS: Mapping[str, Sequence[Mapping[str, Any]]] = {  # other options of an asset, the simplest first
    "pot": ({"spots": 2}, {"closes": True}, {"spots": 2, "closes": True}),
}
_NAME = re.compile(r"[a-z][a-z0-9_]*")
MODULE = '''"""{title}: {text}"""

from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.tasks.shared import jobs
from rf_exp.tasks.shared.jobs import Job
from rf_exp.types import Condition, Scene

VERSION = "1"
PLAN_VERSION = "1"

JOBS = (
{jobs}
)


def plan(scene: Scene, task: Task) -> Proposal:
    """Whoever does it best fetches each thing, in the order that the sentence says."""
    return jobs.plan(scene, task, JOBS)


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """Each thing is where it belongs, upright, let go and at rest."""
    return jobs.conditions(scene, task, JOBS)


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The paper does not know this task; its criterion is ours, without the steps that it must hold."""
    return all(conditions(scene, start, task).values())
'''


@dataclass(frozen=True)
class Composed:
    """A task composed from a sentence."""

    name: str
    text: str  # the sentence
    parsed: Sentence
    node: Mapping[str, Any]  # content of conf/task/<name>.yaml below the name

    @property
    def module(self) -> str:
        """The source of its module."""
        jobs = "\n".join(f"    {job!r}," for job in self.parsed.jobs)
        return MODULE.format(title=self.node["title"], text=self.text, jobs=jobs)

    @property
    def yaml(self) -> str:
        return f"# {self.text}\n" + OmegaConf.to_yaml(OmegaConf.create({self.name: self.node}))


def parse_objects(objects: Iterable[str]) -> dict[str, Mapping[str, Any]]:
    """Name -> asset and options of objects that are listed as `cube`, `red_cube` or `bowl:pot`.

    Several of a kind are distinguished by colour or number. Raises ArgumentError for a name that is used
    twice or is invalid, and for an asset that does not exist.
    """
    entries = [str(item).strip().casefold() for item in objects]
    available, specs = assets.available(), dict[str, Mapping[str, Any]]()
    for entry in entries:
        name, _, kind = entry.rpartition(":")
        if not name:
            kind = next((item for item in available if entry == item or entry.endswith(f"_{item}")), entry)
        if kind not in available:
            raise unknown_choice("object", entry, available)
        name, options = name or entry, dict[str, Any]()
        if _has_option(kind, "colour"):
            colour = next((word for word in name.split("_") if word in circle.COLOURS), None)
            used = {item["options"]["colour"] for item in specs.values() if item["asset"] == kind}
            colour = colour or next((item for item in circle.COLOURS if item not in used), circle.COLOURS[0])
            options["colour"] = colour
            name = f"{colour}_{kind}" if entry == kind and entries.count(entry) > 1 else name
        if entry == kind and entries.count(entry) > 1 and name == entry:
            name = f"{entry}{sum(item['asset'] == kind for item in specs.values()) + 1}"
        if not _NAME.fullmatch(name):
            raise ArgumentError(f"object {entry!r}: the name is {name!r}; expected letters, digits and _")
        if name in specs:
            raise ArgumentError(f"object {name!r} is there twice; give them names, as in {name}1:{kind}")
        specs[name] = {"asset": kind, "options": options}
    return specs


def _has_option(kind: str, option: str) -> bool:
    return option in inspect.signature(import_module(f"rf_exp.tasks.assets.{kind}").build).parameters


def compose(text: str, objects: Iterable[str], name: str, code: str) -> Composed:
    """The task of a sentence. `code` is the full name of its module.

    Raises ArgumentError for a sentence that is not understood or names unknown objects, for objects that do
    not fit together, and for a name that is invalid or taken.
    """
    if not _NAME.fullmatch(name):
        raise ArgumentError(f"name is {name!r}; expected small letters, digits and _")
    if name == "all" or any((CONF / folder / f"{name}.yaml").exists() for folder in ("task", "task/family")):
        raise ArgumentError(f"name is {name!r}, which task={name} means already; choose another one")
    text, specs = " ".join(text.split()), parse_objects(objects)
    if not specs:
        raise ArgumentError(f"objects is empty; available: {', '.join(assets.available())}")
    parsed, specs = _parse_with_variants(text, specs)
    if parsed.arms > len(parsed.jobs):
        raise ArgumentError(
            f"{parsed.arms} arms, but things to move: {len(parsed.jobs)}; an arm would have nothing to do"
        )
    layout = lay_out(parsed, _load_assets(specs), specs)
    node = {
        "name": name,
        "code": code,
        "title": name.replace("_", " ").title(),
        "description": text[:1].upper() + text[1:].rstrip(".") + ".",
        "target_condition": "Everything is where the sentence puts it, let go and at rest.",
        **layout,
        "success": SUCCESS,
    }
    return Composed(name, text, parsed, node)


def _parse_with_variants(
    text: str, specs: Mapping[str, Mapping[str, Any]]
) -> tuple[Sentence, Mapping[str, Mapping[str, Any]]]:
    """The parsed sentence with the objects as given, or with the simplest variants for which it parses."""
    variants = [({}, *VARIANTS.get(spec["asset"], ())) for spec in specs.values()]
    errors: list[ArgumentError] = []
    for choice in sorted(product(*variants), key=lambda choice: sum(map(len, choice))):
        candidate = {
            name: {**spec, "options": {**spec["options"], **options}}
            for (name, spec), options in zip(specs.items(), choice, strict=True)
        }
        try:
            return read(text, _load_assets(candidate)), candidate
        except ArgumentError as error:
            errors.append(error)
    raise errors[-1]


def _load_assets(specs: Mapping[str, Mapping[str, Any]]) -> dict[str, Asset]:
    return {name: assets.load(spec["asset"], spec["options"]) for name, spec in specs.items()}


def write_files(composed: Composed, folder: Path) -> tuple[Path, Path]:
    """Writes both files below a folder and returns their paths. Raises ArgumentError where others exist."""
    paths = folder / "conf" / "task" / f"{composed.name}.yaml", folder / f"{composed.name}.py"
    contents = dict(zip(paths, (composed.yaml, composed.module), strict=True))
    for path, content in contents.items():
        if path.exists() and path.read_text("utf-8") != content:
            raise ArgumentError(
                f"{path} is there already and is another; choose another name=NAME or out=FOLDER"
            )
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, content)
    return paths
