"""Things that are fetched and placed, by one arm after the other."""

from rf_exp.statements import Before, ShareSpace, Statement, Step
from rf_exp.types import Subgoal


def fetch(agent: int, thing: str, target: str, target_point: str | None = None) -> list[Subgoal]:
    """A thing is grasped at its point `center`, and placed."""
    place = Subgoal(agent, "place", thing, target=target, target_point=target_point)
    return [Subgoal(agent, "grasp", thing, "center"), place]


def in_turn(first: Step, then: Step) -> list[Statement]:
    """A step of one arm comes before one of another, and they yield to one another."""
    return [Before(first, then), ShareSpace((first.agent, then.agent))]
