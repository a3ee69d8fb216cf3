"""The RoboBrain that needs no network: the plan written in the task's module."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from rf_exp.datagen.brain.protocol import Question, to_json
from rf_exp.findings import Cause, CheckName, Violation
from rf_exp.statements import Before, Proposal, Step, keep_clear
from rf_exp.tasks import RETRACTED_QPOS, Task
from rf_exp.tasks.predicates import holders
from rf_exp.types import ARM_JOINTS, ConstraintSet, Scene, Subgoal

_NEAR_RAD = 0.1  # from where an arm would go: it is there already


class ScriptedBrain:
    """Answers with the task's own plan for the present scene, once nobody is in anybody's way."""

    name = "scripted"

    def answer(self, question: Question) -> str:
        proposal = question.task.module.plan(question.scene, question.task)
        for violation in question.feedback:
            if leaving := _leaving(violation, proposal, question.scene):
                return to_json(_aside(leaving, question.task))
        return to_json(proposal)


def _leaving(violation: Violation, proposal: Proposal, scene: Scene) -> list[int]:
    """Who draws aside because of a violation, in this order; never one that carries something with another.

    After a hit all that were in it; first the one whose work comes later in the plan, which came to where
    the other stood. Of two that are in each other's way who has nothing to do, or whose work comes later.
    One that finds no way begins again from farther off. Of more than two nothing says who should.
    """
    alone = len(violation.agents) == 1 and violation.check not in (CheckName.COLLISION, CheckName.MOTION)
    if violation.cause not in (Cause.CONTACT, Cause.SPACE) or len(violation.agents) > 2 or alone:
        return []
    planned = [subgoal.agent for subgoal in proposal.subgoals]
    able = [agent for agent in violation.agents if not (_shares(agent, scene) or _is_aside(agent, scene))]
    later = sorted(able, key=lambda agent: -planned.index(agent) if agent in planned else 1)
    if violation.check is CheckName.COLLISION:
        return later
    return [*(agent for agent in later if agent not in planned), *later][:1]


def _shares(agent: int, scene: Scene) -> bool:
    held = scene.held[agent - 1]
    return held is not None and len(holders(scene, held)) > 1


def _is_aside(agent: int, scene: Scene) -> bool:
    return bool(np.abs(scene.qpos[agent - 1, :ARM_JOINTS] - RETRACTED_QPOS).max() < _NEAR_RAD)


def _aside(agents: Sequence[int], task: Task) -> Proposal:
    """These agents draw aside, one after the other."""
    order = tuple(Before(Step(first), Step(then)) for first, then in pairwise(agents))
    return Proposal(tuple(Subgoal(agent, "aside") for agent in agents), (*order, *keep_clear(task.agents)))


@dataclass(frozen=True)
class ScriptedSpec:
    """`brain=scripted`."""

    name: ClassVar[str] = "scripted"
    reads: ClassVar[bool] = False

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> ScriptedBrain:
        return ScriptedBrain()

    def again(self) -> "ScriptedSpec":
        return self
