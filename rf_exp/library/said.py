"""The RoboBrain of a person: it proposes what it was told."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.datagen.brain import Question, to_json
from rf_exp.statements import Proposal
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


class Saying:
    """Answers every question with one proposal."""

    def __init__(self, proposal: Proposal) -> None:
        self.name, self._proposal = Said.name, proposal

    def answer(self, question: Question) -> str:
        return to_json(self._proposal)


@dataclass(frozen=True)
class Said:
    """What it is made from."""

    name: ClassVar[str] = "said"
    reads: ClassVar[bool] = False

    proposal: Proposal

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name, "proposal": to_json(self.proposal)}

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> Saying:
        return Saying(self.proposal)

    def again(self) -> "Said":
        return self
