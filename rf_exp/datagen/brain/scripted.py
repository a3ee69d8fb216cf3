"""The RoboBrain that needs no network: the plan written in the task's module."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.datagen.brain.protocol import Question, to_json
from rf_exp.datagen.yielding import yielding_proposal, yields_after
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


class ScriptedBrain:
    """Answers with the task's own plan for the present scene, once nobody is in anybody's way."""

    name = "scripted"

    def answer(self, question: Question) -> str:
        proposal = question.task.module.plan(question.scene, question.task)
        for violation in question.feedback:
            if agents := yields_after(violation, proposal, question.task, question.scene):
                return to_json(yielding_proposal(agents, question.task))
        return to_json(proposal)


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
