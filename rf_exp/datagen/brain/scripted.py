"""The RoboBrain that needs no network: the plan written in the task's module."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.datagen.brain.protocol import Question, to_json
from rf_exp.tasks import Task
from rf_exp.types import Row


class ScriptedBrain:
    """Answers with the task's own plan for the present scene."""

    name = "scripted"

    def answer(self, question: Question) -> str:
        return to_json(question.task.module.plan(question.scene, question.task))


@dataclass(frozen=True)
class ScriptedSpec:
    """`brain=scripted`."""

    name: ClassVar[str] = "scripted"

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name}

    def make(self, task: Task, row: Row, seed: int) -> ScriptedBrain:
        return ScriptedBrain()

    def again(self) -> "ScriptedSpec":
        return self
