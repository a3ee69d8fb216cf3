"""Logical statements: where and how agents take hold of things (paper, section 3.2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.base import Form, OfAgent, OfAgents, Statement
from rf_exp.statements.events import Step, named
from rf_exp.statements.notation import Words
from rf_exp.statements.verbs import CONTACT_KINDS, VERBS
from rf_exp.statements.vocabulary import agent_name, listed
from rf_exp.types import Kind, Subgoal

WORK = {"place": "what is put on it", "drop": "what is put into it", "tool": "the work of the tool"}
_WHEN = r"(?: (?:when|while) {doing}(?: {object phase}| it)?)?"


@dataclass(frozen=True)
class ContactAt(OfAgent):
    """Interaction position: the gripper of an agent meets an object at an annotated point."""

    kind: ClassVar[Kind] = "logical"

    verb: str  # one that meets a point: grasp, press
    object: str
    point: str

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return ((self.object, self.point),)

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must {self.verb} {self.object} at its {self.point} point."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(r"{agent} (?:{must} )?{verb} {object} (?:at|by|on) (?:its |the )?{point}", cls._read),
            Form(
                r"{agent} (?:{must} )?{verb} (?:the |its ){point} of {object}",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        agent, name, verb = words.agent(), words.object(), words.verb(contact=True) or ""
        point = words.point(name)
        kind = words.kind(name, point)
        if kind not in CONTACT_KINDS:
            raise words.refused(f"is not possible: {point} of {name} is for {WORK[kind]}, not for a gripper")
        if VERBS[verb].meets != kind:
            raise words.refused(f"is not possible: the {point} point of {name} is to {kind}, not to {verb}")
        return cls(agent, verb, name, point)


@dataclass(frozen=True)
class PlaceAt(OfAgent):
    """Where an agent puts an object: at an annotated point of another one."""

    kind: ClassVar[Kind] = "logical"

    object: str
    target: str
    point: str

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return (self.object, None), (self.target, self.point)

    @property
    def sentence(self) -> str:
        who = agent_name(self.agent)
        return f"{who} must place {self.object} at the {self.point} point of {self.target}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        where = r"(?:at|on|in|into) (?:the )?{point} of {object target}"
        return (Form(rf"{{agent}} {{must}} {{verb}} {{object}} {where}", cls._read),)

    @classmethod
    def _read(cls, words: Words) -> Statement:
        agent, name, target = words.agent(), words.object(), words.object("target")
        point = words.point(target)
        if words.verb() != "place":
            raise words.refused(f"is not possible: to {words.verb()} {name} is not to place it")
        if (kind := words.kind(target, point)) in CONTACT_KINDS:
            raise words.refused(f"is not possible: the {point} point of {target} is to {kind}")
        return cls(agent, name, target, point)


@dataclass(frozen=True)
class Direction(OfAgent):
    """Interaction direction: how the gripper of an agent is turned, at contact or while it does something."""

    kind: ClassVar[Kind] = "logical"

    object: str
    direction: str = "perpendicular"  # perpendicular (as annotated) | vertical | horizontal | level
    verb: str | None = None  # what it does then; contact with the object unless given

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return ((self.object, None),)

    @property
    def sentence(self) -> str:
        to = "to" if self.direction == "perpendicular" else "at"
        when = f" when {VERBS[self.verb].gerund} it" if self.verb else ""
        who = agent_name(self.agent)
        return f"The gripper of {who} must be {self.direction} {to} {self.object}{when}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        gripper = r"(?:the (?:gripper|hand) of {agent} (?:{must} (?:be|stay|remain)|is|stays|remains) {is}|"
        keeps = r"{agent} (?:{must} (?:keep|hold)|keeps|holds) (?:its |the )(?:gripper|hand) {is})"
        return (
            Form(r"{agent} (?:{must} )?(?:approach(?:es)?|reach(?:es)?|{meets}) {object} {comes}", cls._read),
            Form(r"the (?:gripper|hand) of {agent} (?:{must} be|is) {is} (?:to|at) {object}"
                 r"(?: (?:when|while) {doing}(?: it)?)?", cls._read),
            Form(rf"{gripper}{keeps} (?:when|while) {{doing}} {{object}}", cls._read),
        )  # fmt: skip

    @classmethod
    def _read(cls, words: Words) -> Statement:
        agent, name, direction = words.agent(), words.object(), words.direction()
        verb = words.verb(contact=words["direction"] in ("from above", "from the side", "perpendicularly"))
        if verb and direction == "perpendicular" and not VERBS[verb].is_contact:
            raise words.refused(
                f"is not possible: perpendicular is about contact, which to {verb} {name} is not; "
                "say vertical, horizontal or level"
            )
        return cls(agent, name, direction, verb)


@dataclass(frozen=True)
class SameHeight(OfAgents):
    """Agents that carry one thing together raise it by the same height; all the while or in one phase."""

    kind: ClassVar[Kind] = "logical"

    verb: str | None = None
    object: str | None = None

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return named(self.phase[0])

    @property
    def sentence(self) -> str:
        when = f" when {VERBS[self.verb].gerund} {self.object}" if self.verb else ""
        return f"{listed(self.who)} must keep a consistent gripper height{when}."

    @property
    def phase(self) -> tuple[Step, ...]:
        """The parts of the plans in which it has to hold; all of them where none is named."""
        return tuple(Step(agent, self.verb, self.object) for agent in self.who)

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        when = r"(?: (?:when|while) {doing} {object})?"
        return (
            Form(
                r"{agents} (?:both )?(?:{must} )?(?:both )?(?:keep|maintain|have|hold) (?:the |a |an )?"
                rf"{{consistent}} (?:gripper )?heights?{when}",
                cls._read,
            ),
            Form(
                r"keep (?:the )?gripper heights? (?:{consistent}|the same)(?: (?:between|of|for) {agents})?"
                + when,
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        verb = words.verb()
        return cls(words.agents(), verb, words.object() if verb else None)


def grasping(subgoals: Iterable[Subgoal]) -> list[Statement]:
    """Interaction position and direction of everything that subgoals grasp."""
    grasps = [each for each in subgoals if each.verb == "grasp" and each.object and each.point]
    positions = [ContactAt(each.agent, "grasp", each.object or "", each.point or "") for each in grasps]
    return [*positions, *(Direction(each.agent, each.object or "") for each in grasps)]


ContactAt.samples = (ContactAt(1, "grasp", "barrier", "left"),)
PlaceAt.samples = (PlaceAt(1, "steak", "pot", "inside"),)
Direction.samples = (Direction(1, "barrier"), Direction(1, "lid", "level", "lift"))
SameHeight.samples = (SameHeight((1, 2)),)
