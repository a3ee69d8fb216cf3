"""Logical: orientation of a gripper (paper, section 3.2, interaction direction)."""

from collections.abc import Iterable
from dataclasses import dataclass

from rf_exp.statements.interaction import ContactAt
from rf_exp.statements.language.base import OneAgentStatement, Statement, Words, agent_name
from rf_exp.statements.language.verbs import VERBS
from rf_exp.types import Subgoal


@dataclass(frozen=True)
class Direction(OneAgentStatement):
    """Interaction direction: orientation of an agent's gripper, at contact or during a subgoal."""

    kind = "logical"
    patterns = (
        r"{agent} (?:{must} )?(?:approach(?:es)?|reach(?:es)?|{meets}) {object} {comes}",
        r"the (?:gripper|hand) of {agent} (?:{must} be|is) {is} (?:to|at) {object}"
        r"(?: (?:when|while) {doing}(?: it)?)?",
        r"(?:the (?:gripper|hand) of {agent} (?:{must} (?:be|stay|remain)|is|stays|remains) {is}|"
        r"{agent} (?:{must} (?:keep|hold)|keeps|holds) (?:its |the )(?:gripper|hand) {is})"
        r" (?:when|while) {doing} {object}",
    )

    object: str
    direction: str = "perpendicular"  # perpendicular (as annotated) | vertical | horizontal | level
    verb: str | None = None  # of the subgoal during which it holds; at contact unless given

    @property
    def sentence(self) -> str:
        preposition = "to" if self.direction == "perpendicular" else "at"
        phase = f" when {VERBS[self.verb].gerund} it" if self.verb else ""
        agent = agent_name(self.agent)
        return f"The gripper of {agent} must be {self.direction} {preposition} {self.object}{phase}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agent, name, direction = words.agent(), words.object(), words.direction()
        verb = words.verb(contact=words["direction"] in ("from above", "from the side", "perpendicularly"))
        if verb and direction == "perpendicular" and not VERBS[verb].is_contact:
            raise words.error(
                f"is not possible: perpendicular is about contact, which to {verb} {name} is not; "
                "say vertical, horizontal or level"
            )
        return cls(agent, name, direction, verb)


def grasping(subgoals: Iterable[Subgoal]) -> list[Statement]:
    """Interaction position and direction of every grasp among subgoals."""
    grasps = [subgoal for subgoal in subgoals if subgoal.verb == "grasp" and subgoal.object and subgoal.point]
    positions = [
        ContactAt(subgoal.agent, "grasp", subgoal.object or "", subgoal.point or "") for subgoal in grasps
    ]
    return [*positions, *(Direction(subgoal.agent, subgoal.object or "") for subgoal in grasps)]


Direction.samples = (Direction(1, "barrier"), Direction(1, "lid", "level", "lift"))
