"""Notation of sentence patterns, and the words that a matched pattern found.

Tokens: `{agent}` an agent, `{agents}` several, `{verb}` a verb of a subgoal, `{does}` one in the present,
`{meets}` one by which a gripper meets a point, `{doing}` the -ing form, `{object}`, `{point}`, `{s}` a time,
`{m}` a length, `{deg}` an angle, `{speed}`, `{low}` and `{high}` corners of a box; `{must}`, `{may}`, `{not}`
and so on, each with its synonyms. Composed: `{did}` an event that must happen, and then is over (Agent_2 must
lift lid), `{ended}` one that is over (Agent_2 has lifted the lid, the lid is on the table), `{starts}` a
beginning. A second word distinguishes tokens that occur twice: `{agent then}`. The rest is a regular
expression without wildcards, over words in lower case.
"""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import count
from math import pi
from typing import Literal

from rf_exp.errors import ArgumentError
from rf_exp.statements.language.verbs import VERBS

Vector = tuple[float, float, float]
Quantity = Literal["m", "s", "deg", "speed"]
UnitScale = tuple[float, float]  # (times, per): a number in the unit times `times / per` is in the base unit


def _by_unit(table: Mapping[str, UnitScale]) -> dict[str, UnitScale]:
    return {unit: scale for units, scale in table.items() for unit in units.split()}


_LENGTHS = {
    "m metre metres meter meters": (1, 1),
    "cm centimetre centimetres centimeter centimeters": (1, 100),
    "mm millimetre millimetres millimeter millimeters": (1, 1000),
}
_TIMES = {
    "s sec secs second seconds": (1, 1),
    "ms millisecond milliseconds": (1, 1000),
    "min mins minute minutes": (60, 1),
}
UNITS: Mapping[
    Quantity, Mapping[str, UnitScale]
] = {  # how they are written: both spellings, singular and plural
    "m": _by_unit(_LENGTHS),
    "s": _by_unit(_TIMES),
    "deg": _by_unit({"deg degree degrees \u00b0": (1, 1), "rad radian radians": (180, pi)}),
    "speed": {
        f"{unit}{per}{second}": scale
        for unit, scale in _by_unit(_LENGTHS).items()
        for per in ("/", " / ", " per ")
        for second in ("s", "sec", "second")
    },
}


def alternatives(words: Iterable[str]) -> str:
    """A regular expression of these words, the longest first."""
    return "|".join(sorted(words, key=lambda word: (-len(word), word)))


def quantity(kind: Quantity, number: str, unit: str) -> float:
    """A number with a unit, converted to m, s, deg or m/s."""
    times, per = UNITS[kind][unit]
    return (float(number) + 0.0) * times / per


NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
_POINT3 = rf"\( *{NUMBER} *, *{NUMBER} *, *{NUMBER} *\)"
_NO_NOUN = (
    "only|after|before|from|at|by|on|in|to|within|and|together|until|while|when|once|then|is|are|was|has|have|"
    "had|been|be|it|must|may|can|of|for|with"
)
_NOUN = rf"(?!(?:{_NO_NOUN})\b)\w+"
_NAME = rf"(?:(?:the|an?|its) )?{_NOUN}(?: {_NOUN})?"
ANY_AGENT_TOKEN = "agent_any"  # in place of a numbered agent
AGENT = rf"(?:agent_\d{{1,3}}|{ANY_AGENT_TOKEN})"

_TOKENS: Mapping[str, str] = {
    "agent": rf"(?P<KEYagent>{AGENT})",
    "agents": rf"(?P<KEYagents>{AGENT}(?:(?:, and |, | and |,){AGENT})+)",
    "object": rf"(?P<KEYobject>{_NAME})",
    "surface": rf"(?P<KEYsurface>{_NAME})",
    "point": r"(?P<KEYpoint>\w+)(?: (?:interaction |contact |grasp )?(?:point|side|end|part|handle))?",
    "is": r"(?P<KEYdirection>perpendicular|vertical|horizontal|level)",
    "comes": r"(?P<KEYdirection>perpendicularly|vertically|horizontally|from above|from the side)",
    **{
        quantity: rf"(?P<KEY{quantity}>{NUMBER}) ?(?P<KEYunit>{alternatives(known)})"
        for quantity, known in UNITS.items()
    },
    "low": rf"(?P<KEYlow>{_POINT3})",
    "high": rf"(?P<KEYhigh>{_POINT3})",
    "must": r"(?:must|should|shall|has to|have to|needs? to|will)",
    "may": r"(?:may|can|could)",
    "not": r"(?:(?:must|should|shall|may) (?:not|never)|can ?not|can never|never)",
    "begin": r"(?:(?:begins?|starts?|proceeds?)(?: {task})?|acts?|moves?)",
    "end": r"(?:completes?|finish(?:es)?|ends?)",
    "finished": (
        r"(?:has |is |have )?(?:finishes|finished|completes|completed|ends|ended|done)"
        r"(?: {task}| {doing KEY} {object KEY})?"
    ),
    "task": r"(?:(?:with )?(?:its|the|their) (?:tasks?|actions?|motions?|work))",
    "consistent": r"(?:consistent|same|equal|identical)",
    "together": r"(?P<KEYtogether>simultaneously|at the same time|together|in sync(?:hrony)?|concurrently)",
    "within": (
        r"(?:,? within {s}(?: (?P<KEYapart>of each other))?|"
        r",? (?P<KEYapart>to within) {s}(?: of each other)?|,? at most {s} (?P<KEYapart>apart))?"
    ),
    "in turn": (
        r"(?:one after the other|one after another|chronologically|in turns?|at different times|sequentially)"
    ),
    "collisions": r"(?:any |all )?collisions?",
    "collide with": (
        r"(?:collide with|touch|hit|interfere with|intersect(?: with)?"
        r"(?: the (?:trajectory|trajectories|paths?) of)?)"
    ),
    "others": r"(?:any |the |all )?other (?:agents?|arms?|robots?)",
    "things": (
        r"(?:(?:the |any |all |all the |other |any other |the other |all other )?(?:objects|obstacles)|"
        r"any (?:other )?(?:object|obstacle)|(?:the |its )?(?:environment|surroundings))"
    ),
    # An action: `Agent_2 lifts lid`, in any form of the verb.
    "did": (
        r"(?:{agent KEY} (?:{must} )?(?:have |has )?{verb KEY} {object KEY}|"
        r"{agent KEY} (?:{must} )?{end}(?: {task}| {doing KEY} {object KEY})?|"
        r"{agent KEY} {finished KEY}|"
        r"{object KEY} (?:{must} be|is) {participle KEY} by {agent KEY}|"
        r"{object KEY} {must} be (?:back )?on {surface KEY})"
    ),
    "ended": (
        r"(?:{agent KEY} (?:has |have )?{verb KEY} {object KEY}|{agent KEY} {finished KEY}|"
        r"{object KEY} (?:is|was|has been) {participle KEY} by {agent KEY}|"
        r"{object KEY} (?:is|lies|has been put) (?:back )?on {surface KEY})"
    ),
    "starts": (
        r"(?:{agent KEY} (?:(?:{must}|{may}) )?{begin}|"
        r"{agent KEY} (?:(?:{must}|{may}|is (?:allowed )?to) )?(?:(?:begin|start)s? to )?"
        r"{does KEY} {object KEY}|"
        r"{agent KEY} (?:begins?|starts?) {doing KEY} {object KEY})"
    ),
}
_TOKEN = re.compile(r"\{(in turn|collide with|\w+)(?: (\w*))?\}")


def compile_pattern(notation: str) -> re.Pattern[str]:
    """The pattern of a notation.

    Groups are numbered, as one may be in two alternatives; `matched_groups` undoes it.
    """
    return _compile_pattern(notation, tuple(VERBS))


@cache
def _compile_pattern(notation: str, verbs: tuple[str, ...]) -> re.Pattern[str]:
    all_verbs = [VERBS[name] for name in verbs]
    forms = [forms for verb in all_verbs for forms in verb.forms]
    contact_forms = [forms for verb in all_verbs if verb.is_contact for forms in verb.forms]
    tokens = {
        **_TOKENS,
        "verb": _any_verb(word for verb in all_verbs for word in verb.finite_forms),
        "does": _any_verb(word for verb_forms in forms for word in verb_forms[:2]),
        "participle": _any_verb(verb_forms[3] for verb_forms in forms),
        "meets": _any_verb(word for verb_forms in contact_forms for word in verb_forms[:2]),
        "doing": _any_verb(verb_forms[4] for verb_forms in forms),
    }

    def expand(token: re.Match[str]) -> str:
        name, key = token.groups()
        if name not in tokens:
            raise ArgumentError(
                f"no token {name!r} in the notation of patterns; available: {', '.join(tokens)}"
            )
        inner = tokens[name].replace(" KEY}", f" {key}}}" if key else "}")
        return _TOKEN.sub(expand, inner).replace("KEY", f"{key}_" if key else "")

    parts, pattern = count(), _TOKEN.sub(expand, notation)
    return re.compile(re.sub(r"\(\?P<(\w+)>", lambda group: f"(?P<{group[1]}__{next(parts)}>", pattern))


def _any_verb(words: Iterable[str]) -> str:
    return f"(?P<KEYverb>{alternatives(set(words))})"


def matched_groups(match: re.Match[str]) -> dict[str, str]:
    return {name.partition("__")[0]: value for name, value in match.groupdict().items() if value is not None}


def object_name(words: str) -> str:
    """The object name that words stand for: `red_cube` for `the red cube`."""
    return re.sub(r"^(?:the|an?|its) ", "", words).replace(" ", "_")


def number(value: float) -> str:
    """A number as written in sentences: all its digits, without `.0`."""
    return repr(float(value)).removesuffix(".0")


def vector(values: Vector) -> str:
    """`(-0.1, 0.2, 0)`."""
    return f"({', '.join(map(number, values))})"
