"""Findings of checks, as values: agents, time, amount, obstacles. Sentences are written from them.

Agents are numbered from 1. There is one clock: `time_s` is in seconds since the start of the episode. A
finding has a template of its sentence, which names facts in braces. No code parses such a sentence.
"""

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Any, TypedDict

from rf_exp.errors import ArgumentError


class Finding(StrEnum):
    """Kind of finding, with the template of its sentence: here after the first colon."""

    template: str

    def __new__(cls, text: str) -> "Finding":
        code, _, template = text.partition(": ")
        finding = str.__new__(cls, code)
        finding._value_, finding.template = code, template
        return finding

    # Contact with objects.
    BESIDE_POINT = (
        "meets it beside the point: {a} {meets} {object} {cm:.1f} cm from its {aspect} point (allowed "
        "{bound_cm:.1f} cm)"
    )
    PUT_BESIDE_POINT = (
        "puts it beside the point: {a} would put {object} {cm:.1f} cm beside the {aspect} (allowed "
        "{bound_cm:.1f} cm)"
    )
    NO_CONTACT = (
        "makes no contact: {a} must meet {object} at its {aspect} point, but {a} neither holds {object} nor "
        "makes contact with it in this plan; its subgoals that move: {listed}"
    )
    NO_DIRECTION = (
        "makes no contact that has a direction: the gripper of {a} must be {aspect} at {object}, but {a} "
        "neither holds {object} nor makes contact with it in this plan; its subgoals that move: {listed}"
    )
    OFF_DIRECTION = (
        "comes from another direction: the gripper of {a} is {value:.0f} deg off {aspect} at {object} "
        "(allowed {bound:.0f} deg)"
    )
    UNEVEN = (
        "heights drift apart: the gripper heights of {agents} drift {cm:.1f} cm apart (allowed "
        "{bound_cm:.1f} cm)"
    )
    TILTED = (
        "tilts it: {at} {object}, held by {a} ({state}), is tilted by {value:.1f} deg (allowed {bound:g} deg)"
    )
    HOLDS_IT = "holds it already: {a} holds {object} already"

    # Order and time.
    TOO_SOON = "begins too soon: {then} begins {value:.2f} s after {first} has ended (at least {bound:g} s)"
    NOT_TOGETHER = "does not begin together: {agents} begin {first} {value:.2f} s apart (allowed {bound:g} s)"
    TOO_LATE = "ends too late: {first} ends {value:.2f} s after the start of the plan (allowed {bound:g} s)"
    TOO_FAST = (
        "moves too fast: {at} the gripper of {a} ({state}) moves at {value:.2f} m/s (allowed {bound:.2f} m/s)"
    )
    SHARED = (
        "shares space: {a} and {b} use the same space one after the other: closest in time {at}, when {b} "
        "comes to where {a} has been until {value:.2f} s before"
    )
    NOT_SHARED = "shares no space: {agents} use no space that another of them uses at any time"

    # Space.
    CLOSE = (
        "comes too close: {at} {a}, {a_does}, comes within {cm:.1f} cm of {b}, {b_does} ({parts[0]} near "
        "{parts[1]})"
    )
    CLOSE_TO_THING = (
        "comes too close to a thing: {at} {a}, {a_does}, comes within {cm:.1f} cm of {obstacle} "
        "({parts[0]}), which it may not touch"
    )
    TOUCHING = "touch: {both} touch each other with {value:.0f} N"
    OVERLAPPING = "overlap: {both} overlap by {depth_mm:.0f} mm ({parts[0]} with {parts[1]})"
    TOO_NEAR = (
        "does not keep its distance: {at} the {aspect} of {everyone}, are {cm:.1f} cm apart (at least "
        "{bound_cm:.1f} cm)"
    )
    OFF_HEIGHT = (
        "leaves its heights: {at} the gripper of {a} ({state}) is {cm:.1f} cm over the table (it has to stay"
        " {aspect} {bound_cm:.1f} cm)"
    )
    IN_ZONE = "enters a zone: {a} {at} enters the keep-out {obstacle} ({parts[0]}, {state})"
    OUT_OF_ZONE = "stays out of a zone: {a} stays out of the keep-out {obstacle} ({parts[0]}, {state})"
    CLEAR = "stays clear: {both} stay {cm:.1f} cm apart"
    CLEAR_OF_THING = "stays clear of a thing: {a} stays {cm:.1f} cm clear of {obstacle}"

    # Schedules: why there is none.
    UNEQUAL = (
        "plans of other lengths: {both} do {first!r} together but one of them plans {value:g} s more; plan "
        "it as one motion"
    )
    NO_SCHEDULE = (
        "no schedule within the budget: no schedule was found within the search budget; plan fewer subgoals "
        "at once or one after the other"
    )
    CLOSE_AT_FIRST = (
        "stand too close: {both} already stand too close to each other; move one of them away first"
    )
    CLOSE_AT_LAST = (
        "would end too close: {both} would end too close to each other ({a} {a_is}, {b} {b_is}); timing "
        "cannot help, choose another end or retreat"
    )
    PARKED = (
        "stands in the way: where {parked} stands before and after its motion blocks {blocked} {blocked_is};"
        " timing cannot help, {blocked} needs another path or {parked} must yield"
    )
    BLOCKED_BOTH = (
        "block each other: {both} block each other: they get no further than {a} {a_is} and {b} {b_is}; one "
        "of them needs another path or a place to wait"
    )
    ORDERS = (
        "orders that contradict one another: the constraints on the order of {both} contradict one another: "
        "they get no further than {a} {a_is} and {b} {b_is}; drop or change one of them"
    )
    ORDERS_OR_WAYS = (
        "orders that contradict one another, or the way past each other: the constraints on the order of "
        "{both} contradict one another or their way past each other: they get no further than {a} {a_is} and"
        " {b} {b_is}; drop or change one of them"
    )
    DEADLINE = (
        "cannot be done in time: {a} cannot be done within {bound:g} s; the shortest schedule needs "
        "{value:g} s"
    )
    NOT_ALL = (
        "cannot pass all together: every pair of agents could pass, but not all together; let some of them "
        "finish first"
    )

    # Motion: why there is none.
    BLOCKED = "is blocked: {a} cannot {first}: {in_the_way}{how_near}"
    NO_ROOM = (
        "leaves the hand no room: {a} cannot {first}, whatever way its hand is turned: {in_the_way}{how_near}"
    )
    TAKEN = (
        "place is taken: {a} cannot {first}: {object} would overlap {obstacle} there by {depth_mm:.0f} mm; "
        "move one of them"
    )
    NO_PATH = "finds no free path: {a} cannot {first}: no free path{how_near}"
    NOBODY = "is in nobody's reach: none of {agents} can {first}: out of reach"
    OUT_OF_REACH = "is out of reach: {a} cannot {first}: out of reach"
    TOO_HIGH = "does not reach that high: {a} cannot {first}: the arm does not reach that high"
    NO_RETREAT = "cannot retreat: {a} cannot retreat after letting go of {object}"
    HOLDS_OTHER = "holds something: {a} already holds {object}"
    HOLDS_NOT = "does not hold it: {a} cannot {first}: it does not hold {object}"
    NO_TARGET = "no such place: there is no place or object {aspect!r}; available: {names}"
    NO_POINT = "no such point: {object} has no place point {aspect!r}; available: {names}"
    NO_PLACE = "no place: {object} has no place point: nothing can be put there"
    CIRCLE = (
        "subgoals that wait for one another: the subgoals wait for one another: their orders are in conflict"
        " ({listed})"
    )
    UNEVEN_LIFT = "lift by different heights: agents lift {object} by different heights"

    # Execution.
    HIT = "hit each other: {everyone}, hit each other with {value:.0f} N (arms stop at {bound:g} N)"
    PUSHES = "pushes: {everyone}, pushes {obstacle} with {value:.0f} N (arms stop at {bound:g} N)"
    DROPPED = "no longer holds: {everyone}, no longer holds {object}"
    STRAYED = (
        "off its path: {everyone}, is {value:.2f} rad off its path (allowed {bound:g} rad): something is in "
        "its way"
    )
    OBJECT_MOVED = "object_moved: a disturbed arm has moved {object} by {mm:.0f} mm"
    CLUTTER_MOVED = "clutter_moved: an arm, or what it carries, has moved {object} by {mm:.0f} mm"

    # Why an answer is refused before there is a plan.
    UNREACHED = "model not reached: {refusal}"
    REJECTED = "request rejected: {refusal}"
    SPENT = "calls used up: {refusal}"
    DECLINED = "model declines: {refusal}"
    CUT_OFF = "answer cut off: {refusal}"
    NO_ANSWER = "no answer: {refusal}"
    NO_JSON = "no JSON: {refusal}"
    OTHER_FORM = "another form: {refusal}"
    UNKNOWN_AGENT = "unknown agent: {refusal}"
    UNKNOWN_OBJECT = "unknown object: {refusal}"
    UNKNOWN_POINT = "unknown point: {refusal}"
    UNREAD_SUBGOAL = "subgoal not understood: {refusal}"
    TOO_MANY_SUBGOALS = "too many subgoals: {refusal}"
    UNREAD_CONSTRAINT = "constraint not understood: {refusal}"
    UNFITTING_CONSTRAINT = "constraint that does not fit the subgoals: {refusal}"

    # Others.
    REFUSED = "not understood: {refusal}"
    IDLE = "not in this plan: nothing in this plan is about it"
    CONSTRAINT = "breaks a constraint: {at} {constraint!r}: {value:.4g} {unit} (bound {bound:g} {unit})"


class CheckName(StrEnum):
    """Source of a finding: a validation function of the paper, the execution monitor, or the loop itself."""

    INTERACTION = "ValidateInteraction"
    DIRECTION = "ValidateDirection"
    SCHEDULING = "ValidateScheduling"
    OCCUPANCY = "ValidateSpatialOccupancy"
    COLLISION = "Collision"  # arms that have hit something
    TRACKING = "Tracking"  # an arm off its path
    OBJECT_MOTION = "ObjectMotion"  # a disturbed arm that has moved an object outside its subgoal
    MOTION = "Motion"  # no motion was found for a proposal
    CODE = "CheckCode"  # constraints that cannot be compiled
    BRAIN = "RoboBrain"  # no usable answer


class Cause(StrEnum):
    """Category of a violation."""

    CONTACT = "contact"  # arms that hit something
    SPACE = "space"  # free space for an arm
    TIME = "time"  # order and time
    REACH = "reach"  # what an arm can reach
    INTERACTION = "interaction"  # where and how it makes contact
    GRIP = "grip"  # what it holds
    TRACKING = "tracking"  # whether it follows its path
    ANSWER = "answer"  # the answer itself


@dataclass(frozen=True)
class Doing:
    """Activity of an agent at a moment of its plan."""

    subgoal: str  # its text
    primitive: str
    along_s: float | None = None  # time along its own path, waiting excluded, where that matters


@dataclass(frozen=True)
class FindingFacts:
    """A finding with its facts. Its kind (`Finding`) determines which facts after the numbers it has."""

    finding: Finding = Finding.CONSTRAINT
    value: float = 0.0  # what was found, in `unit`
    bound: float = 0.0  # what is allowed, in `unit`
    unit: str = ""  # empty for a fraction, and where there is no number
    _: KW_ONLY
    time_s: float  # since the start of the episode
    agents: tuple[int, ...] = ()  # concerned: two that are in each other's way, one that cannot reach
    measured: bool = False  # on the real state; otherwise planned, before anything moves
    obstacles: tuple[str, ...] = ()  # what was in the way: objects, agents, zones
    object: str | None = None  # concerned
    aspect: str = ""  # of the object or agent: point, direction, side or parts in question
    doing: tuple[Doing | None, ...] = ()  # of each agent then; None: it stands still
    parts: tuple[str, ...] = ()  # the links and objects that are nearest to one another
    subgoals: tuple[str, ...] = ()  # concerned
    known: tuple[str, ...] = ()  # available names, in place of an unknown one
    refusal: str = ""  # message of the parser of an answer
    constraint: str = ""  # as it was stated
    tried: tuple[str, ...] = ()  # the paths that were tried, where there is more than one way to plan

    @property
    def sentence(self) -> str:
        """Sentence that a person and a language model can act on."""
        text = self.finding.template.format_map(self)
        return f"{text}; paths were tried {', then '.join(self.tried)}" if self.tried else text

    def __getitem__(self, name: str) -> Any:
        """Value of a name in a template: a fact as it is, or as written in sentences."""
        return _TEMPLATE_VALUES[name](self) if name in _TEMPLATE_VALUES else getattr(self, name)


class FactArguments(TypedDict, total=False):
    """Facts of `FindingFacts` besides its numbers, to be passed as keyword arguments."""

    agents: tuple[int, ...]
    measured: bool
    obstacles: tuple[str, ...]
    object: str | None
    aspect: str
    doing: tuple[Doing | None, ...]
    parts: tuple[str, ...]
    subgoals: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Violation(FindingFacts):
    """A check that failed, with the evidence."""

    check: CheckName
    cause: Cause

    @property
    def code(self) -> str:
        """Name of its finding: `unknown_object`, `out_of_reach`."""
        return self.finding.name.lower()

    @property
    def kind(self) -> str:
        """Agents, finding and object, without what depends on the seed: equal failures have equal texts."""
        agents = " and ".join(map(agent_name, self.agents))
        concerned = self.obstacles or ((self.object,) if self.object else ())
        return ": ".join(filter(None, (agents, f"{self.finding} {', '.join(concerned)}".strip())))


class ParseError(ArgumentError):
    """Text that cannot be understood, as an error with its finding."""

    def __init__(self, message: object, finding: Finding = Finding.REFUSED) -> None:
        super().__init__(str(message))
        self.finding = finding


def agent_name(agent: int) -> str:
    """`Agent_1`, as in the paper; `Anybody` where any agent may do it."""
    return f"Agent_{agent}" if agent else "Anybody"


def agent_names(agents: tuple[int, ...]) -> str:
    """`Agent_1` or `[Agent_1, Agent_2]`, as in the paper's check code."""
    joined = ", ".join(map(agent_name, agents))
    return joined if len(agents) == 1 else f"[{joined}]"


def _activity_text(activity: Doing | None) -> str:
    return "standing still" if activity is None else f"to {activity.subgoal} ({activity.primitive})"


def _position_text(activity: Doing | None) -> str:
    return (
        "where it stands"
        if activity is None
        else f"{activity.along_s:.2f} s along its own way, {_activity_text(activity)}"
    )


def _agents_with_activities(facts: FindingFacts) -> str:
    if not facts.doing:
        return agent_names(facts.agents)
    pairs = zip(facts.agents, facts.doing, strict=True)
    return ", and ".join(f"{agent_name(agent)}, {_activity_text(activity)}" for agent, activity in pairs)


def _moving_index(facts: FindingFacts) -> int:
    """Index of the one of two agents that moves."""
    return next((k for k, activity in enumerate(facts.doing) if activity is not None), 0)


def _nearest_parts_text(facts: FindingFacts) -> str:
    """Nearest parts of agent and obstacle with their distance, where known."""
    if not facts.parts:
        return ""
    aspect = f"{facts.aspect} " if facts.aspect else ""
    distance = f"{facts.value * 100:.1f} cm of {facts.parts[1]}; at least {facts.bound * 100:.1f} cm"
    return f" ({aspect}its {facts.parts[0]} comes within {distance})"


# Name in a template -> its text, for names that are not plain facts.
_TEMPLATE_VALUES: Mapping[str, Callable[[FindingFacts], object]] = {
    "agents": lambda facts: agent_names(facts.agents),
    "a": lambda facts: agent_name(facts.agents[0]),
    "b": lambda facts: agent_name(facts.agents[1]),
    "both": lambda facts: " and ".join(map(agent_name, facts.agents[:2])),
    "everyone": _agents_with_activities,
    "a_does": lambda facts: _activity_text(facts.doing[0]),
    "b_does": lambda facts: _activity_text(facts.doing[1]),
    "a_is": lambda facts: _position_text(facts.doing[0]),
    "b_is": lambda facts: _position_text(facts.doing[1]),
    "state": lambda facts: "as measured" if facts.measured else _activity_text(facts.doing[0]),
    "meets": lambda facts: "meets" if facts.measured else "would meet",
    "blocked": lambda facts: agent_name(facts.agents[_moving_index(facts)]),
    "blocked_is": lambda facts: _position_text(facts.doing[_moving_index(facts)]),
    "parked": lambda facts: agent_name(facts.agents[1 - _moving_index(facts)]),
    "at": lambda facts: f"at {facts.time_s:.2f} s",
    "cm": lambda facts: facts.value * 100,
    "bound_cm": lambda facts: facts.bound * 100,
    "mm": lambda facts: facts.value * 1000,
    "depth_mm": lambda facts: -facts.value * 1000,
    "first": lambda facts: facts.subgoals[0],
    "then": lambda facts: facts.subgoals[1],
    "listed": lambda facts: "; ".join(facts.subgoals) or "none",
    "names": lambda facts: ", ".join(facts.known) or "none",
    "obstacle": lambda facts: facts.obstacles[0],
    "in_the_way": lambda facts: ", ".join(f"{obstacle} is in the way" for obstacle in facts.obstacles),
    "how_near": _nearest_parts_text,
}
