"""Who yields, where to, and when: decided here alone, for the planner and for the scripted brain.

An arm that yields takes a posture in which it is in nobody's way. In a plan it does so before the others
begin or once it is done (`Yielding`, of each of `ways`); after a violation in a proposal of its own
(`yields_after`, `yielding_proposal`). When exactly it moves is up to the schedule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Cause, CheckName, Finding, Violation, agent_name
from rf_exp.statements import Before, Proposal, ShareSpace, Step, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders
from rf_exp.types import ConstraintSet, Scene, Subgoal

Posture = Literal["home", "aside"]  # the verb that leads there: at rest, or retracted over its own base

_NEAR_RAD = 0.1  # from the retracted posture: an arm has yielded already


def posture_rad(posture: Posture, task: Task, agent: int) -> NDArray[np.float64]:
    """(dof,) where an agent that yields goes."""
    robot = task.robots[agent - 1]
    return np.array(robot.model.aside_rad if posture == "aside" else robot.rest_rad)


@dataclass(frozen=True)
class Yielding:
    """Who yields in a plan beside what is proposed, each where a way is free."""

    first: tuple[int, ...] = ()  # before the others begin, retracted
    once_done: frozenset[int] = frozenset()  # when they have let go of something and have nothing more to do
    to: Posture = "home"  # where those go


@dataclass(frozen=True)
class Way:
    """How to plan a proposal."""

    avoid_arms: bool  # whether paths go round arms that stand still
    yielding: Yielding = Yielding()

    def __str__(self) -> str:
        """As a refusal says what was tried."""
        paths = f"{'round' if self.avoid_arms else 'regardless of'} the other arms"
        first = ", ".join(map(agent_name, self.yielding.first))
        retracted = [f"with {first} retracted first"] if first else []
        retracted += ["each retracted once done"] if self.yielding.to == "aside" else []
        return ", ".join([paths, *retracted])


def ways(proposal: Proposal, scene: Scene, constraint_set: ConstraintSet) -> Sequence[Way]:
    """The ways to plan a proposal, the best first."""
    if not constraint_set.spatial:  # then those do that share space one after the other, if time counts
        shared = (each.agents for each in proposal.constraints if isinstance(each, ShareSpace))
        sharing = frozenset(agent for pair in shared for agent in pair if constraint_set.temporal)
        return [Way(False, Yielding(once_done=sharing))]
    done = frozenset(range(1, len(scene.held) + 1))
    free = tuple(agent for agent in sorted(done) if scene.held[agent - 1] is None)
    idle = tuple(agent for agent in free if not proposal.of(agent))
    here, begins = Yielding(once_done=done), proposal.subgoals[0].agent
    still = {subgoal.agent for subgoal in proposal.subgoals if subgoal.verb == "hold"}
    waiting = tuple(agent for agent in free if agent != begins and agent not in still)
    farther = [Yielding(some, done, "aside") for some in dict.fromkeys((idle, waiting))]
    if not constraint_set.temporal:
        return [Way(True, each) for each in dict.fromkeys((here, Yielding(idle, done), *farther))]
    # Who knows when arms move may pass one before it is in the way, and may send it farther off.
    return [Way(False, here), Way(True, here), *(Way(False, each) for each in farther)]


def yields_after(violation: Violation, proposal: Proposal, task: Task, scene: Scene) -> list[int]:
    """Who yields because of a violation, in this order; never one that carries something with another.

    After a hit all that were in it; first the one whose work comes later in the plan, which came to where
    the other stood. Of two that are in each other's way who has nothing to do, or whose work comes later.
    One that finds no way begins again from farther off. Of more than two nothing says who should, and a
    place that is taken stays so.
    """
    if violation.finding is Finding.TAKEN:
        return []
    alone = len(violation.agents) == 1 and violation.check not in (CheckName.COLLISION, CheckName.MOTION)
    if violation.cause not in (Cause.CONTACT, Cause.SPACE) or len(violation.agents) > 2 or alone:
        return []
    planned = [subgoal.agent for subgoal in proposal.subgoals]
    able = [agent for agent in violation.agents if _can_yield(agent, task, scene)]
    later = sorted(able, key=lambda agent: -planned.index(agent) if agent in planned else 1)
    if violation.check is CheckName.COLLISION:
        return later
    return [*(agent for agent in later if agent not in planned), *later][:1]


def yielding_proposal(agents: Sequence[int], task: Task) -> Proposal:
    """These agents take their retracted postures, one after the other."""
    order = tuple(Before(Step(first), Step(then)) for first, then in pairwise(agents))
    return Proposal(tuple(Subgoal(agent, "aside") for agent in agents), (*order, *keep_clear(task.agents)))


def _can_yield(agent: int, task: Task, scene: Scene) -> bool:
    """Whether it carries nothing with another, and has not yielded already."""
    held, here = scene.held[agent - 1], task.arms[agent].joints(scene.qpos[agent - 1])
    if held is not None and len(holders(scene, held)) > 1:
        return False
    return bool(np.abs(here - posture_rad("aside", task, agent)).max() >= _NEAR_RAD)
