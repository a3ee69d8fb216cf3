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
from rf_exp.types import ANYBODY

NUMBERS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "both": 2}
MOST_ARMS = 6
FORMS = (
    "two arms put both cubes into the bowl",
    "the lid goes on last",
    "then the red cube goes onto the blue cube",
    "arm 2 stacks all cubes on the goal",
)
_ARMS = r"(?:robot(?:ic)? )?(?:arms|robots|agents|arm|robot|agent)"
_ACTIVE = "puts?|places?|brings?|lays?|sets?|drops?|moves?|carr(?:y|ies)"
_BE = "goes|go|comes|come|is|are|must be|is put|are put|is placed|are placed|lies|lie"
_PREPOSITION = "into|inside|in|onto|on top of|on|to|at"
_WHO = rf"(?:(?P<many>\w+) {_ARMS}|{_ARMS} (?P<agent>\d+)|they|somebody)"
_CLAUSE = re.compile(
    rf"(?:{_WHO} )?(?:(?P<stacks>stacks?)|(?:{_ACTIVE})) (?P<what>.+?)"
    rf"(?: (?P<preposition>{_PREPOSITION}) (?P<target>.+?))?(?: (?P<order>first|last))?"
)
_PASSIVE = re.compile(
    rf"(?P<what>.+?) (?:{_BE})(?: (?P<preposition>{_PREPOSITION})(?: (?P<target>(?!first$|last$).+?))?)?"
    r"(?: (?P<order>first|last))?"
)
_SPLIT = re.compile(
    r"\s*(?:[;.,]\s*(?:and\s+)?(?P<one>then\b|after that\b|afterwards\b)?|\band then\b|\bthen\b)\s*"
)


@dataclass(frozen=True)
class Sentence:
    """A parsed sentence."""

    arms: int
    jobs: tuple[Job, ...]


def read(text: str, things: Mapping[str, Asset]) -> Sentence:
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
        said = {key: value for key, value in match.groupdict().items() if value is not None}
        arms = max(arms, _arms(said, clause))
        names = _named(said["what"], things, clause)
        stacks = "stacks" in said
        target = _target(said, things, jobs, clause, names)
        agent = int(said["agent"]) if "agent" in said else ANYBODY
        new: list[Job] = []
        for name in names:
            if borne := [job.thing for job in [*jobs, *new] if job.target == name]:
                raise ArgumentError(f"{clause!r} moves {name}, on which {borne[0]} has been put before")
            point = _point(target, things, said.get("preposition", "on"), [*jobs, *new], name, clause)
            before = (*(previous if follows else ()), *((new[-1].thing,) if stacks and new else ()))
            rests = tuple(job.thing for job in [*jobs, *new] if job.thing == target)
            after = tuple(dict.fromkeys((*before, *rests)))
            new.append(Job(name, _grip(name, things[name]), target, point, after, agent))
            target = name if stacks else target
        jobs, previous = [*jobs, *new], names
        if "order" in said:
            (last if said["order"] == "last" else first).append(names)
    for names in first:
        jobs = [job if job.thing in names else _after(job, names) for job in jobs]
    for names in last:
        others = tuple(job.thing for job in jobs if job.thing not in names)
        jobs = [_after(job, others) if job.thing in names else job for job in jobs]
    return Sentence(arms, tuple(_ordered(jobs, text)))


def _clauses(text: str) -> list[tuple[str, bool]]:
    """Clauses in lower case without articles, each with whether it comes after the one before."""
    found: list[tuple[str, bool]] = []
    begin, follows = 0, False
    plain = " ".join(text.casefold().split())
    for match in [*_SPLIT.finditer(plain), None]:
        part = plain[begin : match.start() if match else len(plain)]
        part = re.sub(r"\b(?:the|a|an) ", "", part.removeprefix("and ").strip())
        if part:
            found.append((part, follows and bool(found)))
            follows = False
        if match:
            follows = follows or "then" in match[0] or "after" in match[0]
            begin = match.end()
    return found


def _arms(said: Mapping[str, str], clause: str) -> int:
    if "agent" in said:
        number = int(said["agent"])
    elif (many := said.get("many")) is None:
        return 1
    elif many in NUMBERS or many.isdecimal():
        number = NUMBERS.get(many) or int(many)
    else:
        raise ArgumentError(f"{clause!r}: {many!r} is no number of arms; expected 1 to {MOST_ARMS}")
    if not 1 <= number <= MOST_ARMS:
        raise ArgumentError(f"{clause!r} speaks of {number} arms; possible are 1 to {MOST_ARMS}")
    return number


def _named(what: str, things: Mapping[str, Asset], clause: str) -> tuple[str, ...]:
    """The objects that words stand for: by name, by kind, all of a kind, or several joined by `and`."""
    if " and " in what:
        return tuple(name for part in what.split(" and ") for name in _named(part, things, clause))
    words = what.split()
    count: int | None = 1
    if words[0] in ("all", "every", "each", "everything"):
        count, words = None, words[1:]
    elif words[0] in NUMBERS and len(words) > 1:
        count, words = NUMBERS[words[0]], words[1:]
    fitting = _fitting(words, things) if words else tuple(things)
    if not fitting:
        raise ArgumentError(f"{clause!r}: there is no {' '.join(words)!r}; there are {_listed(things)}")
    if count is not None and len(fitting) != count:
        raise ArgumentError(
            f"{clause!r}: {what!r} means {count} of {len(fitting)}: {', '.join(fitting)}; say which"
        )
    return fitting


def _fitting(words: Sequence[str], things: Mapping[str, Asset]) -> tuple[str, ...]:
    """The objects of that name, else of that kind: a `red cube` is one called red_cube, or red_cube_2."""
    said = [_singular(word) for word in words]
    called = "_".join(said)
    if called in things:
        return (called,)
    *adjectives, noun = said
    return tuple(
        name
        for name, asset in things.items()
        if noun in (asset.name, re.sub(r"\d+$", "", name)) and set(adjectives) <= {*name.split("_")}
    )


def _singular(word: str) -> str:
    return word[:-1] if word.endswith("s") and not word.endswith("ss") and len(word) > 3 else word


def _target(
    said: Mapping[str, str],
    things: Mapping[str, Asset],
    jobs: Sequence[Job],
    clause: str,
    names: Sequence[str],
) -> str:
    """The target of a clause; by default that of the last job before it."""
    if "target" in said:
        target, *others = _named(said["target"], things, clause)
        if others:
            raise ArgumentError(f"{clause!r}: {said['target']!r} is more than one place; say which")
    elif jobs:
        target = jobs[-1].target
    else:
        raise ArgumentError(f"{clause!r} does not say where; forms: {'; '.join(FORMS)}")
    if target in names:
        raise ArgumentError(f"{clause!r}: {target} cannot be put on itself")
    return target


def _point(
    target: str, things: Mapping[str, Asset], preposition: str, jobs: Sequence[Job], name: str, clause: str
) -> str:
    """The first free point of the target for another object."""
    kind, into = ("drop", "into") if preposition in ("into", "inside", "in") else ("place", "on")
    points = [label for label, point in things[target].points.items() if point.kind == kind]
    taken = {job.point: job.thing for job in jobs if job.target == target}
    free = [label for label in points if label not in taken]
    if not points:
        kinds = {known: {point.kind for point in asset.points.values()} for known, asset in things.items()}
        able = ", ".join(known for known, has in kinds.items() if kind in has) or "nothing"
        raise ArgumentError(f"{clause!r}: nothing can be put {into} {target}; what it can: {able}")
    if not free:
        raise ArgumentError(
            f"{clause!r}: {name} has no place {preposition} {target}, which takes {len(points)}: there is "
            f"{', '.join(taken.values())}"
        )
    return free[0]


def _grip(name: str, asset: Asset) -> str:
    grips = [label for label, point in asset.points.items() if point.kind == "grasp"]
    if not grips or asset.static:
        raise ArgumentError(f"{name} cannot be grasped; it is a {asset.name}")
    return grips[0]


def _after(job: Job, names: Sequence[str]) -> Job:
    return replace(job, after=tuple(dict.fromkeys((*job.after, *names))))


def _ordered(jobs: Sequence[Job], text: str) -> list[Job]:
    """Jobs in topological order. Raises ArgumentError for a cycle, or for an object with two jobs."""
    names = [job.thing for job in jobs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ArgumentError(f"{text!r} puts {', '.join(twice)} somewhere twice; a thing has one place")
    left, done = list(jobs), list[Job]()
    while left:
        ready = [job for job in left if {*job.after} <= {each.thing for each in done}]
        if not ready:
            circle = ", ".join(f"{job.thing} after {' and '.join(job.after)}" for job in left)
            raise ArgumentError(f"{text!r}: no order has {circle}")
        done.append(ready[0])
        left.remove(ready[0])
    return done


def _listed(things: Mapping[str, Asset]) -> str:
    kinds = ((name, "" if name == asset.name else f" ({asset.name})") for name, asset in things.items())
    return ", ".join(name + kind for name, kind in kinds)
