"""From a line such as `grasp barrier at left` to a Subgoal."""

import re

from rf_exp.errors import ArgumentError
from rf_exp.statements.language import units
from rf_exp.statements.language.verbs import PARTS, VERBS
from rf_exp.statements.language.vocabulary import Vocabulary, agent_name
from rf_exp.types import Subgoal

LONGEST = 200  # characters of a subgoal
HIGHEST_M = 100.0  # no arm comes near it; what it reaches is for the planner to say
_SHOWN = 80
_SUBGOAL = re.compile(
    r"(?P<verb>\w+)"
    r"(?: (?P<object>(?!at\b|to\b|by\b)\w+))?"
    r"(?: at (?P<point>\w+))?"
    r"(?: to (?P<target>\w+)(?: at (?P<target_point>\w+))?)?"
    rf"(?: by (?P<height_m>\d{{1,4}}(?:\.\d{{1,4}})?) ?(?P<unit>{units.pattern(units.UNITS['m'])}))?\.?",
    re.IGNORECASE,
)


def subgoal_forms() -> tuple[str, ...]:
    """How subgoals are written, one form a verb."""
    return tuple(verb.form for verb in VERBS.values())


def read_subgoal(agent: int, text: str, vocabulary: Vocabulary) -> Subgoal:
    """The subgoal in a line. Raises ArgumentError with the forms or names that exist."""
    match = _SUBGOAL.fullmatch(" ".join(text.split())) if len(text) <= LONGEST else None
    verb = VERBS.get(match["verb"].lower()) if match else None
    where = f"subgoal {text.strip()[:_SHOWN]!r} of {agent_name(agent)}"
    if match is None or verb is None:
        raise ArgumentError(f"cannot read {where}; forms: {', '.join(subgoal_forms())}")
    said = {part: match[part] for part in PARTS if match[part] is not None}
    if missing := [part for part in verb.needs if part not in said]:
        raise ArgumentError(f"{where} lacks {' and '.join(missing)}")
    if strange := sorted(set(said).difference(verb.needs, verb.may_have)):
        raise ArgumentError(
            f"{where} has {' and '.join(strange)}, which {verb.name} has no use for; "
            f"forms: {', '.join(subgoal_forms())}"
        )
    height_m = None
    if "height_m" in said:
        height_m = units.value("m", said.pop("height_m"), match["unit"].casefold())
        if height_m >= HIGHEST_M:
            raise ArgumentError(f"{where} is by {height_m:g} m; expected less than {HIGHEST_M:g} m")
    subgoal = Subgoal(agent, verb.name, height_m=height_m, **said)
    _check_names(subgoal, where, vocabulary)
    return subgoal


def _check_names(subgoal: Subgoal, where: str, vocabulary: Vocabulary) -> None:
    if subgoal.object is not None and subgoal.object not in vocabulary.points:
        raise ArgumentError(
            f"no object {subgoal.object!r} in {where}; available: {', '.join(sorted(vocabulary.points))}"
        )
    for name, point in ((subgoal.object, subgoal.point), (subgoal.target, subgoal.target_point)):
        points = vocabulary.points.get(name or "")
        if points is not None and point is not None and point not in points:
            available = ", ".join(sorted(points)) or "none"
            raise ArgumentError(f"{name} has no interaction point {point!r}; available: {available}")
    if subgoal.object is not None and subgoal.point is not None:
        points, verb = vocabulary.points[subgoal.object], VERBS[subgoal.verb]
        fitting = [name for name, kind in points.items() if kind == verb.meets]
        if subgoal.point not in fitting:
            raise ArgumentError(
                f"{where}: the point {subgoal.point} is to {points[subgoal.point]}; points of "
                f"{subgoal.object} to {subgoal.verb} {'with' if verb.meets == 'tool' else 'at'}: "
                f"{', '.join(fitting) or 'none'}"
            )
