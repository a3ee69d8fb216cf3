from dataclasses import dataclass

from rf_exp.statements.language.base import Statement, Step, Words, agent_name
from rf_exp.statements.language.notation import number


@dataclass(frozen=True)
class Deadline(Statement):
    """A part of an agent's plan ends within a time from the start of the plan (paper, section 3.2)."""

    kind = "temporal"
    patterns = (
        r"{agent} (?:(?:{must} )?{end}(?: {task}| {doing} {object})?|{must} be done) within {s}",
        r"{agent} (?:{must} )?{does} {object} within {s}",
    )

    step: Step
    within_s: float

    @property
    def sentence(self) -> str:
        action = self.step.action_text("finish")
        return f"{agent_name(self.step.agent)} must {action} within {number(self.within_s)} s."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        return cls(words.step(), words.seconds())


Deadline.samples = (Deadline(Step(1), 10.0), Deadline(Step(1, "lift", "barrier"), 10.0))
