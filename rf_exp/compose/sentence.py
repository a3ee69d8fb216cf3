"""Parser of sentences into jobs: objects, their targets and order, and the number of arms.

A small grammar, matched and never executed, as that of constraints: a clause is understood as a whole or
refused with the possible forms.

    two arms put both cubes into the bowl, the lid goes on last
    three robots put the red cube on the goal, then the blue cube goes onto the red cube
    arm 2 stacks all cubes on the plinth
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.shared.jobs import Job
from rf_exp.types import ANY_AGENT

NUMBERS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "both": 2}
MAX_ARMS = 6
FORMS = (
    "two arms put both cubes into the bowl",
    "the lid goes on last",
    "then the red cube goes onto the blue cube",
    "arm 2 stacks all cubes on the goal",
)
_ARM_NOUN = r"(?:robot(?:ic)? )?(?:arms|robots|agents|arm|robot|agent)"
_ACTIVE_VERBS = "puts?|places?|brings?|lays?|sets?|drops?|moves?|carr(?:y|ies)"
_STATE_VERBS = "goes|go|comes|come|is|are|must be|is put|are put|is placed|are placed|lies|lie"
_PREPOSITION = "into|inside|in|onto|on top of|on|to|at"
_AGENT = rf"(?:(?P<many>\w+) {_ARM_NOUN}|{_ARM_NOUN} (?P<agent>\d+)|they|somebody)"
_CLAUSE = re.compile(
    rf"(?:{_AGENT} )?(?:(?P<stacks>stacks?)|(?:{_ACTIVE_VERBS})) (?P<what>.+?)"
    rf"(?: (?P<preposition>{_PREPOSITION}) (?P<target>.+?))?(?: (?P<order>first|last))?"
)
_PASSIVE = re.compile(
    rf"(?P<what>.+?) (?:{_STATE_VERBS})"
    rf"(?: (?P<preposition>{_PREPOSITION})(?: (?P<target>(?!first$|last$).+?))?)?"
    r"(?: (?P<order>first|last))?"
)
_CLAUSE_SEPARATOR = re.compile(
    r"\s*(?:[;.,]\s*(?:and\s+)?(?P<one>then\b|after that\b|afterwards\b)?|\band then\b|\bthen\b)\s*"
)


@dataclass(frozen=True)
class Sentence:
    """A parsed sentence."""

    arms: int
    jobs: tuple[Job, ...]


def read(text: str, assets: Mapping[str, Asset]) -> Sentence:
    """The jobs of a sentence about objects, given by name.

    Raises ArgumentError for a clause that is not understood, for an object that is unknown, ambiguous or
    cannot be grasped, and for a place that does not exist or is taken.
    """
    arms, jobs = 1, list[Job]()
    clauses = list(_clauses(text))
    if not clauses:
        raise ArgumentError(f"the sentence {text!r} says nothing; forms: {'; '.join(FORMS)}")
    last: list[tuple[str, ...]] = []  # objects that come last of all
    first: list[tuple[str, ...]] = []
    previous: tuple[str, ...] = ()
    for clause, follows in clauses:
        match = _CLAUSE.fullmatch(clause) or _PASSIVE.fullmatch(clause)
        if match is None:
            raise ArgumentError(f"cannot read {clause!r} of {text!r}; forms: {'; '.join(FORMS)}")
        groups = {key: value for key, value in match.groupdict().items() if value is not None}
        arms = max(arms, _arm_count(groups, clause))
        names = _object_names(groups["what"], assets, clause)
        stacks = "stacks" in groups
        target = _target(groups, assets, jobs, clause, names)
        agent = int(groups["agent"]) if "agent" in groups else ANY_AGENT
        clause_jobs: list[Job] = []
        for name in names:
            if placed_on_it := [job.thing for job in [*jobs, *clause_jobs] if job.target == name]:
                raise ArgumentError(
                    f"{clause!r} moves {name}, on which {placed_on_it[0]} has been put before"
                )
            point = _free_point(
                target, assets, groups.get("preposition", "on"), [*jobs, *clause_jobs], name, clause
            )
            predecessors = (
                *(previous if follows else ()),
                *((clause_jobs[-1].thing,) if stacks and clause_jobs else ()),
            )
            on_target = tuple(job.thing for job in [*jobs, *clause_jobs] if job.thing == target)
            after = tuple(dict.fromkeys((*predecessors, *on_target)))
            clause_jobs.append(Job(name, _grasp_point(name, assets[name]), target, point, after, agent))
            target = name if stacks else target
        jobs, previous = [*jobs, *clause_jobs], names
        if "order" in groups:
            (last if groups["order"] == "last" else first).append(names)
    for names in first:
        jobs = [job if job.thing in names else _with_predecessors(job, names) for job in jobs]
    for names in last:
        others = tuple(job.thing for job in jobs if job.thing not in names)
        jobs = [_with_predecessors(job, others) if job.thing in names else job for job in jobs]
    return Sentence(arms, tuple(_in_order(jobs, text)))


def _clauses(text: str) -> list[tuple[str, bool]]:
    """Clauses in lower case without articles, each with whether it comes after the one before."""
    clauses: list[tuple[str, bool]] = []
    start, follows = 0, False
    normalised = " ".join(text.casefold().split())
    for match in [*_CLAUSE_SEPARATOR.finditer(normalised), None]:
        part = normalised[start : match.start() if match else len(normalised)]
        part = re.sub(r"\b(?:the|a|an) ", "", part.removeprefix("and ").strip())
        if part:
            clauses.append((part, follows and bool(clauses)))
            follows = False
        if match:
            follows = follows or "then" in match[0] or "after" in match[0]
            start = match.end()
    return clauses


def _arm_count(groups: Mapping[str, str], clause: str) -> int:
    if "agent" in groups:
        count = int(groups["agent"])
    elif (count_word := groups.get("many")) is None:
        return 1
    elif count_word in NUMBERS or count_word.isdecimal():
        count = NUMBERS.get(count_word) or int(count_word)
    else:
        raise ArgumentError(f"{clause!r}: {count_word!r} is no number of arms; expected 1 to {MAX_ARMS}")
    if not 1 <= count <= MAX_ARMS:
        raise ArgumentError(f"{clause!r} speaks of {count} arms; possible are 1 to {MAX_ARMS}")
    return count


def _object_names(phrase: str, assets: Mapping[str, Asset], clause: str) -> tuple[str, ...]:
    """The objects that words stand for: by name, by kind, all of a kind, or several joined by `and`."""
    if " and " in phrase:
        return tuple(name for part in phrase.split(" and ") for name in _object_names(part, assets, clause))
    words = phrase.split()
    count: int | None = 1
    if words[0] in ("all", "every", "each", "everything"):
        count, words = None, words[1:]
    elif words[0] in NUMBERS and len(words) > 1:
        count, words = NUMBERS[words[0]], words[1:]
    matches = _matching_names(words, assets) if words else tuple(assets)
    if not matches:
        raise ArgumentError(f"{clause!r}: there is no {' '.join(words)!r}; there are {_object_list(assets)}")
    if count is not None and len(matches) != count:
        raise ArgumentError(
            f"{clause!r}: {phrase!r} means {count} of {len(matches)}: {', '.join(matches)}; say which"
        )
    return matches


def _matching_names(words: Sequence[str], assets: Mapping[str, Asset]) -> tuple[str, ...]:
    """The objects of that name, else of that kind: a `red cube` is one called red_cube, or red_cube_2."""
    singulars = [_singular(word) for word in words]
    joined = "_".join(singulars)
    if joined in assets:
        return (joined,)
    *adjectives, noun = singulars
    return tuple(
        name
        for name, asset in assets.items()
        if noun in (asset.name, re.sub(r"\d+$", "", name)) and set(adjectives) <= {*name.split("_")}
    )


def _singular(word: str) -> str:
    return word[:-1] if word.endswith("s") and not word.endswith("ss") and len(word) > 3 else word


def _target(
    groups: Mapping[str, str],
    assets: Mapping[str, Asset],
    jobs: Sequence[Job],
    clause: str,
    names: Sequence[str],
) -> str:
    """The target of a clause; by default that of the last job before it."""
    if "target" in groups:
        target, *others = _object_names(groups["target"], assets, clause)
        if others:
            raise ArgumentError(f"{clause!r}: {groups['target']!r} is more than one place; say which")
    elif jobs:
        target = jobs[-1].target
    else:
        raise ArgumentError(f"{clause!r} does not say where; forms: {'; '.join(FORMS)}")
    if target in names:
        raise ArgumentError(f"{clause!r}: {target} cannot be put on itself")
    return target


def _free_point(
    target: str, assets: Mapping[str, Asset], preposition: str, jobs: Sequence[Job], name: str, clause: str
) -> str:
    """The first free point of the target for another object."""
    kind, into = ("drop", "into") if preposition in ("into", "inside", "in") else ("place", "on")
    points = [label for label, point in assets[target].points.items() if point.kind == kind]
    occupied = {job.point: job.thing for job in jobs if job.target == target}
    free = [label for label in points if label not in occupied]
    if not points:
        kinds = {
            target_name: {point.kind for point in asset.points.values()}
            for target_name, asset in assets.items()
        }
        suitable = (
            ", ".join(target_name for target_name, point_kinds in kinds.items() if kind in point_kinds)
            or "nothing"
        )
        raise ArgumentError(f"{clause!r}: nothing can be put {into} {target}; what it can: {suitable}")
    if not free:
        raise ArgumentError(
            f"{clause!r}: {name} has no place {preposition} {target}, which takes {len(points)}: there is "
            f"{', '.join(occupied.values())}"
        )
    return free[0]


def _grasp_point(name: str, asset: Asset) -> str:
    grasp_points = [label for label, point in asset.points.items() if point.kind == "grasp"]
    if not grasp_points or asset.static:
        raise ArgumentError(f"{name} cannot be grasped; it is a {asset.name}")
    return grasp_points[0]


def _with_predecessors(job: Job, names: Sequence[str]) -> Job:
    return replace(job, after=tuple(dict.fromkeys((*job.after, *names))))


def _in_order(jobs: Sequence[Job], text: str) -> list[Job]:
    """Jobs in topological order. Raises ArgumentError for a cycle, or for an object with two jobs."""
    names = [job.thing for job in jobs]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ArgumentError(f"{text!r} puts {', '.join(repeated)} somewhere twice; a thing has one place")
    remaining, ordered = list(jobs), list[Job]()
    while remaining:
        ready = [job for job in remaining if {*job.after} <= {placed.thing for placed in ordered}]
        if not ready:
            cycle = ", ".join(f"{job.thing} after {' and '.join(job.after)}" for job in remaining)
            raise ArgumentError(f"{text!r}: no order has {cycle}")
        ordered.append(ready[0])
        remaining.remove(ready[0])
    return ordered


def _object_list(assets: Mapping[str, Asset]) -> str:
    kinds = ((name, "" if name == asset.name else f" ({asset.name})") for name, asset in assets.items())
    return ", ".join(name + kind for name, kind in kinds)
