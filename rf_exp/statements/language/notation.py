"""The small notation in which patterns of sentences are written, and the words that a pattern found.

`{agent}` an agent, `{agents}` several, `{verb}` a verb of a subgoal, `{does}` one in the present, `{meets}`
one by which a gripper meets a point, `{doing}` the -ing form, `{object}`, `{point}`, `{s}` a time, `{m}` a
length, `{deg}` an angle, `{speed}`, `{low}` and `{high}` corners of a box; `{must}`, `{may}`, `{not}` and
so on ways to say so. Composed: `{did}` what must happen, and then is over (Agent_2 must lift lid),
`{ended}` that it is over (Agent_2 has lifted the lid, the lid is on the table), `{starts}` that something
begins. A second word tells apart what stands twice: `{agent then}`. The rest is a regular expression
without wildcards, over words in lower case.
"""

import itertools
import re
from collections.abc import Mapping
from functools import cache

from rf_exp.errors import ArgumentError
from rf_exp.statements.language import units
from rf_exp.statements.language.events import Event, LiesOn, Step
from rf_exp.statements.language.verbs import VERBS
from rf_exp.statements.language.vocabulary import TABLE, Vocabulary

ZONE_LIMIT_M = 10.0  # no zone reaches farther from the origin
MAX_WAIT_S = 600.0
TOGETHER_S = 0.1  # what `simultaneously` means when no time is given
DIRECTIONS = {  # of a gripper that is so, or comes so
    "perpendicular": "perpendicular",
    "perpendicularly": "perpendicular",
    "vertical": "vertical",
    "vertically": "vertical",
    "from above": "vertical",
    "horizontal": "horizontal",
    "horizontally": "horizontal",
    "from the side": "horizontal",
    "level": "level",
}

Vector = tuple[float, float, float]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
_POINT3 = rf"\( *{_NUMBER} *, *{_NUMBER} *, *{_NUMBER} *\)"
_NO_NOUN = (
    "only|after|before|from|at|by|on|in|to|within|and|together|until|while|when|once|then|is|are|was|has|have|"
    "had|been|be|it|must|may|can|of|for|with"
)
_NOUN = rf"(?!(?:{_NO_NOUN})\b)\w+"
_NAME = rf"(?:(?:the|an?|its) )?{_NOUN}(?: {_NOUN})?"
_AGENT = r"agent_\d{1,3}"
_COLLISIONS = r"(?:any |all )?collisions?"

_TOKENS: Mapping[str, str] = {
    "agent": rf"(?P<KEYagent>{_AGENT})",
    "agents": rf"(?P<KEYagents>{_AGENT}(?:(?:, and |, | and |,){_AGENT})+)",
    "object": rf"(?P<KEYobject>{_NAME})",
    "surface": rf"(?P<KEYsurface>{_NAME})",
    "point": r"(?P<KEYpoint>\w+)(?: (?:interaction |contact |grasp )?(?:point|side|end|part|handle))?",
    "is": r"(?P<KEYdirection>perpendicular|vertical|horizontal|level)",
    "comes": r"(?P<KEYdirection>perpendicularly|vertically|horizontally|from above|from the side)",
    **{
        quantity: rf"(?P<KEY{quantity}>{_NUMBER}) ?(?P<KEYunit>{units.pattern(known)})"
        for quantity, known in units.UNITS.items()
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
    "collisions": _COLLISIONS,
    "collide with": (
        r"(?:collide with|touch|hit|interfere with|intersect(?: with)?"
        r"(?: the (?:trajectory|trajectories|paths?) of)?)"
    ),
    "others": r"(?:any |the |all )?other (?:agents?|arms?|robots?)",
    "things": (
        r"(?:(?:the |any |all |all the |other |any other |the other |all other )?(?:objects|obstacles)|"
        r"any (?:other )?(?:object|obstacle)|(?:the |its )?(?:environment|surroundings))"
    ),
    # An action: `Agent_2 lifts lid`, whatever the form of the verb.
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


def compiled(notation: str) -> re.Pattern[str]:
    """The pattern of a notation. A part that stands in two alternatives is numbered; `found` takes it off."""
    return _compiled(notation, tuple(VERBS))


@cache
def _compiled(notation: str, verbs: tuple[str, ...]) -> re.Pattern[str]:
    known = [VERBS[name] for name in verbs]
    tokens = {
        **_TOKENS,
        "verb": _any("verb", [word for verb in known for word in verb.finite]),
        "does": _any("verb", [word for verb in known for word in verb.present]),
        "participle": _any("verb", [word for verb in known for word in verb.participles]),
        "meets": _any("verb", [word for verb in known if verb.is_contact for word in verb.present]),
        "doing": _any("verb", [word for verb in known for word in verb.gerunds]),
    }

    def expanded(token: re.Match[str]) -> str:
        name, key = token.groups()
        if name not in tokens:
            raise ArgumentError(
                f"no token {name!r} in the notation of patterns; available: {', '.join(tokens)}"
            )
        inner = tokens[name].replace(" KEY}", f" {key}}}" if key else "}")
        return _TOKEN.sub(expanded, inner).replace("KEY", f"{key}_" if key else "")

    count = itertools.count()
    whole = _TOKEN.sub(expanded, notation)
    return re.compile(re.sub(r"\(\?P<(\w+)>", lambda group: f"(?P<{group[1]}__{next(count)}>", whole))


def _any(group: str, words: list[str]) -> str:
    longest_first = sorted(dict.fromkeys(words), key=lambda word: (-len(word), word))
    return f"(?P<KEY{group}>{'|'.join(longest_first)})"


def found(match: re.Match[str]) -> dict[str, str]:
    """What the parts of a pattern matched."""
    return {name.partition("__")[0]: value for name, value in match.groupdict().items() if value is not None}


def canonical(word: str) -> str:
    """The verb of a subgoal that a word stands for."""
    return next(verb.name for verb in VERBS.values() if word in (*verb.finite, *verb.gerunds))


def object_name(words: str) -> str:
    """The name that words for an object stand for."""
    return re.sub(r"^(?:the|an?|its) ", "", words).replace(" ", "_")


def number(value: float) -> str:
    """A number as sentences have it: no shorter than it is, and without `.0`."""
    return repr(float(value)).removesuffix(".0")


def vector(values: Vector) -> str:
    """`(-0.1, 0.2, 0)`."""
    return f"({', '.join(map(number, values))})"


class Words:
    """The parts of a matched sentence, looked up in the vocabulary of a task."""

    def __init__(
        self, parts: Mapping[str, str], text: str, vocabulary: Vocabulary, filed: tuple[int, ...] = ()
    ):
        """`filed` are the agents under which an answer lists the sentence."""
        self._parts, self.text, self.vocabulary, self._filed = parts, text, vocabulary, filed
        self._where = f"constraint {text!r}"

    def __contains__(self, part: str) -> bool:
        return part in self._parts

    def __getitem__(self, part: str) -> str:
        """The words of a named group of the pattern."""
        return self._parts[part]

    def agent(self, key: str = "") -> int:
        return self._known(self._part("agent", key))

    def agents(self) -> tuple[int, ...]:
        """The agents of the sentence; where it names none those it is filed under, or else all."""
        listed = self._parts.get("agents")
        named = re.findall(_AGENT, listed) if listed else [f"agent_{agent}" for agent in self._filed]
        agents = tuple(dict.fromkeys(map(self._known, named))) or self.vocabulary.agents
        return self.several(agents)

    def pair(self) -> tuple[int, int]:
        """The two agents of a sentence that is about one and another one."""
        one, other = self.several((self.agent(), self.agent("other")))
        return one, other

    def several(self, agents: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(agents)) < 2:
            named = ", ".join(f"Agent_{agent}" for agent in dict.fromkeys(agents))
            raise self.refused(f"needs two different agents; it names {named or 'none'}")
        return agents

    def object(self, key: str = "") -> str:
        return self.vocabulary.object(object_name(self._part("object", key)), self._where)

    def surface(self, key: str = "") -> str:
        name = object_name(self._part("surface", key))
        return name if name == TABLE else self.vocabulary.object(name, self._where)

    def point(self, name: str, key: str = "") -> str:
        return self.vocabulary.point(name, self._part("point", key), self._where)

    def kind(self, name: str, point: str) -> str:
        return self.vocabulary.points[name][point]

    def verb(self, key: str = "", contact: bool = False) -> str | None:
        """The verb of a subgoal that a word stands for; None where the sentence has none.

        `contact` is whether the sentence says where or whence the gripper comes. Raises ArgumentError for a
        word that says something else here.
        """
        if (word := self._parts.get(f"{key}_verb" if key else "verb")) is None:
            return None
        verb = VERBS[canonical(word)]
        if narrow := verb.narrowed(word):
            name = self.object(key)
            if name.lower().rpartition("_")[2] != narrow.of and not (contact and narrow.contact):
                raise self.refused(narrow.otherwise.format(object=name))
        return verb.name

    def direction(self) -> str:
        return DIRECTIONS[self._part("direction", "")]

    def step(self, key: str = "") -> Step:
        """The part of an agent's plan that the sentence speaks of; all of it where it names no verb."""
        verb = self.verb(key)
        return Step(self.agent(key), verb, self.object(key)) if verb else Step(self.agent(key))

    def event(self, key: str = "") -> Event:
        if (f"{key}_surface" if key else "surface") in self._parts:
            name, surface = self.object(key), self.surface(key)
            if name == surface:
                raise self.refused(f"is not possible: {name} does not lie on itself")
            return LiesOn(name, surface)
        return self.step(key)

    def seconds(self, default_s: float | None = None, largest_s: float = MAX_WAIT_S) -> float:
        return self.quantity("s", largest_s, default_s)

    def quantity(
        self, part: units.Quantity, largest: float, default: float | None = None, smallest: float = 0.0
    ) -> float:
        """A length in m, a time in s, an angle in deg or a speed in m/s; its default where none is said."""
        if part not in self._parts and default is not None:
            return default
        value = units.value(part, self._parts[part], self._parts["unit"])
        if not smallest <= value <= largest:
            unit = units.BASE[part]
            bounds = f"{smallest:g} and {largest:g} {unit}"
            raise self.refused(f"is not possible: {value:g} {unit} is not between {bounds}")
        return value

    def zone(self) -> tuple[Vector, Vector]:
        """The corners of a box, m."""
        corners = [[float(n) + 0.0 for n in re.findall(_NUMBER, self._parts[key])] for key in ("low", "high")]
        if max(abs(value) for corner in corners for value in corner) > ZONE_LIMIT_M:
            raise self.refused(f"is not possible: zones lie within {ZONE_LIMIT_M:g} m of the origin")
        (x0, x1), (y0, y1), (z0, z1) = (sorted(pair) for pair in zip(*corners, strict=True))
        if min(x1 - x0, y1 - y0, z1 - z0) < 1e-3:
            raise self.refused("is not possible: the zone is flat; each side must be at least 1 mm")
        return (x0, y0, z0), (x1, y1, z1)

    def refused(self, why: str) -> ArgumentError:
        return ArgumentError(f"{self._where} {why}")

    def _part(self, name: str, key: str) -> str:
        return self._parts[f"{key}_{name}" if key else name]

    def _known(self, agent: str) -> int:
        return self.vocabulary.agent(int(agent.removeprefix("agent_")), self._where)
