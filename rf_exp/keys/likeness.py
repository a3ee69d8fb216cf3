"""Which key was meant by one that is not there."""

from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher
from functools import cache
from pathlib import Path

import yaml

from rf_exp.installed import CONF
from rf_exp.keys.files import content, inner

ALWAYS = CONF / "config.yaml", CONF / "policy" / "paper.yaml"  # of which every configuration is made
RENAMED: Mapping[str, str] = yaml.safe_load(Path(__file__).with_name("renamed.yaml").read_text("utf-8"))
ALIKE = 0.65  # of 1, from here on one word may be meant by another: of three letters one may be wrong


def nearest(key: str, possible: Iterable[str]) -> list[str]:
    """The dotted keys that are most like one: of those that stand beside it, or else of all."""
    parent, _, last = key.rpartition(".")
    ends = {other: other.rpartition(".")[2] for other in possible}
    beside = {other: end for other, end in ends.items() if other.rpartition(".")[0] == parent}
    if found := _best(last, beside):
        return found
    found = _best(last, ends)  # below another parent
    return _best(key, {other: other for other in found}, 0.0)


def _best(word: str, among: Mapping[str, str], least: float = ALIKE) -> list[str]:
    """Those whose words are most like one."""
    likeness = {other: SequenceMatcher(None, word, said).ratio() for other, said in among.items()}
    best = max(likeness.values(), default=0.0)
    return [other for other, value in likeness.items() if value == best >= least]


@cache
def keys_of_files() -> Mapping[str, str]:
    """Dotted key -> the choice that has it, empty for every configuration: all that `conf/` has."""
    found = {key: "" for path in ALWAYS for key in inner(content(path))}
    for group in ("task", "arch", "constraints", "brain"):
        for path in sorted((CONF / group).glob("*.yaml")):
            for key in inner(content(path)):
                found.setdefault(f"{group}.{key}", f"{group}={path.stem}")
    return found


def no_key(key: str, possible: Iterable[str], where: str = "") -> str:
    """The sentence about a key that is not there."""
    if choice := keys_of_files().get(key):
        return f"there is no key {key!r}{where}; it comes with {choice}."
    if key in RENAMED:
        return f"there is no key {key!r}{where}; it is {RENAMED[key]} now."
    near = nearest(key, possible)
    return f"there is no key {key!r}{where}" + (f"; did you mean {' or '.join(near)}?" if near else ".")


def keys_are_in() -> str:
    """Where a person finds those that are there."""
    files = " and ".join(shown(path) for path in ALWAYS)
    return f"The keys are in {files}, those of tasks in {shown(CONF / 'task')}"


def shown(path: Path) -> str:
    """A path as people write it: from the current folder on, if it is below."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
