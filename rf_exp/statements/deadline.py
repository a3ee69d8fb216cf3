"""Temporal: a part of a plan is over in time (paper, section 3.2)."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.language.base import Form, Statement
from rf_exp.statements.language.events import Step, named
from rf_exp.statements.language.notation import Words, number
from rf_exp.statements.language.vocabulary import agent_name
from rf_exp.types import Kind


@dataclass(frozen=True)
class Deadline(Statement):
    """A part of an agent's plan is over in time, counted from the start of the plan."""

    kind: ClassVar[Kind] = "temporal"

    step: Step
    within_s: float

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.step.agent,)

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return named(self.step)

    @property
    def sentence(self) -> str:
        what = f"{self.step.verb} {self.step.object}" if self.step.verb else "finish"
        return f"{agent_name(self.step.agent)} must {what} within {number(self.within_s)} s."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"{agent} (?:(?:{must} )?{end}(?: {task}| {doing} {object})?|{must} be done) within {s}",
                cls._read,
            ),
            Form(r"{agent} (?:{must} )?{does} {object} within {s}", cls._read),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        return cls(words.step(), words.seconds())


Deadline.samples = (Deadline(Step(1), 10.0), Deadline(Step(1, "lift", "barrier"), 10.0))
