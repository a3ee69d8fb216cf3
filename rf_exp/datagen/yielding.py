"""Yielding: which arms get out of the way, where to and when; used by the planner and the scripted brain.

An arm that yields takes a posture in which it is in nobody's way. In a plan it does so before the others
begin or once it is done (`Yielding`, one for each of `planning_modes`); after a violation, in a separate
proposal (`yielding_agents`, `yielding_proposal`). The schedule decides when exactly it moves.
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

_NEAR_RAD = 0.1  # so near to the retracted posture, an arm has yielded already


def posture_rad(posture: Posture, task: Task, agent: int) -> NDArray[np.float64]:
    """(dof,) the posture to which an agent yields."""
    robot = task.robots[agent - 1]
    return np.array(robot.model.aside_rad if posture == "aside" else robot.rest_rad)


@dataclass(frozen=True)
class Yielding:
    """Agents that yield in a plan, beside what is proposed, each where a path is free."""

    first: tuple[int, ...] = ()  # agents that retract before the others begin
    once_done: frozenset[int] = frozenset()  # agents that yield if their last subgoal ends with a retreat
    posture: Posture = "home"  # posture of agents in `once_done`


@dataclass(frozen=True)
class PlanningMode:
    """One way to plan a proposal."""

    avoid_arms: bool  # whether paths avoid arms at rest
    yielding: Yielding = Yielding()

    def __str__(self) -> str:
        """Its text in `Violation.tried`."""
        paths = f"{'round' if self.avoid_arms else 'regardless of'} the other arms"
        retracted_agents = ", ".join(map(agent_name, self.yielding.first))
        details = [f"with {retracted_agents} retracted first"] if retracted_agents else []
        details += ["each retracted once done"] if self.yielding.posture == "aside" else []
        return ", ".join([paths, *details])


def planning_modes(proposal: Proposal, scene: Scene, constraint_set: ConstraintSet) -> Sequence[PlanningMode]:
    """The ways to plan a proposal, the best first."""
    if not constraint_set.spatial:  # then only agents that share space yield, if time counts
        shared = (each.agents for each in proposal.constraints if isinstance(each, ShareSpace))
        sharing = frozenset(agent for pair in shared for agent in pair if constraint_set.temporal)
        return [PlanningMode(False, Yielding(once_done=sharing))]
    done = frozenset(range(1, len(scene.held) + 1))
    free = tuple(agent for agent in sorted(done) if scene.held[agent - 1] is None)
    idle = tuple(agent for agent in free if not proposal.subgoals_of(agent))
    at_end, first_agent = Yielding(once_done=done), proposal.subgoals[0].agent
    holding = {subgoal.agent for subgoal in proposal.subgoals if subgoal.verb == "hold"}
    waiting = tuple(agent for agent in free if agent != first_agent and agent not in holding)
    retracting = [Yielding(agents, done, "aside") for agents in dict.fromkeys((idle, waiting))]
    if not constraint_set.temporal:
        options = dict.fromkeys((at_end, Yielding(idle, done), *retracting))
        return [PlanningMode(True, yielding) for yielding in options]
    # With a schedule, paths may cross where an arm will be later, and arms may yield farther off.
    options = [(False, at_end), (True, at_end), *((False, yielding) for yielding in retracting)]
    return [PlanningMode(avoid_arms, yielding) for avoid_arms, yielding in options]


def yielding_agents(violation: Violation, proposal: Proposal, task: Task, scene: Scene) -> list[int]:
    """Agents that yield because of a violation, in this order; never one that carries an object with another.

    After a collision, all involved, first the one whose work comes later in the plan, which moved to where
    the other was. Of two in each other's way, the one without subgoals, else the one with the later work. An
    agent that finds no path starts again from farther off. Among more than two there is no rule, and an
    occupied place stays occupied.
    """
    if violation.finding is Finding.TAKEN:
        return []
    alone = len(violation.agents) == 1 and violation.check not in (CheckName.COLLISION, CheckName.MOTION)
    if violation.cause not in (Cause.CONTACT, Cause.SPACE) or len(violation.agents) > 2 or alone:
        return []
    busy = [subgoal.agent for subgoal in proposal.subgoals]
    candidates = [agent for agent in violation.agents if _can_yield(agent, task, scene)]
    by_work = sorted(candidates, key=lambda agent: -busy.index(agent) if agent in busy else 1)
    if violation.check is CheckName.COLLISION:
        return by_work
    return [*(agent for agent in by_work if agent not in busy), *by_work][:1]


def yielding_proposal(agents: Sequence[int], task: Task) -> Proposal:
    """Proposal in which these agents take their retracted postures, one after the other."""
    order = tuple(Before(Step(first), Step(then)) for first, then in pairwise(agents))
    return Proposal(tuple(Subgoal(agent, "aside") for agent in agents), (*order, *keep_clear(task.agents)))


def _can_yield(agent: int, task: Task, scene: Scene) -> bool:
    """Whether an agent carries nothing with another, and has not yielded already."""
    held, joints = scene.held[agent - 1], task.arms[agent].joints(scene.qpos[agent - 1])
    if held is not None and len(holders(scene, held)) > 1:
        return False
    return bool(np.abs(joints - posture_rad("aside", task, agent)).max() >= _NEAR_RAD)
