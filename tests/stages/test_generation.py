"""Generation: each seed a row, and what the rows say."""

import json

from rf_exp.datagen.brain import Question, ScriptedBrain, ScriptedSpec
from rf_exp.datagen.episode import EpisodeMaker, Nobody, Settings
from rf_exp.datagen.version import generator_version
from rf_exp.sim.simulator import Simulator
from rf_exp.stages.generation import generation_row
from rf_exp.tasks import Task
from rf_exp.types import Row, Violation

FULL = Row("full")


class Answers(ScriptedBrain):
    """Says what it was told to say, then what the script says."""

    def __init__(self, *first: str) -> None:
        self.first = list(first)

    def answer(self, question: Question) -> str:
        return self.first.pop(0) if self.first else super().answer(question)


class Rejections(Nobody):
    """Counts violations where they happen."""

    count = 0

    def rejected(self, violation: Violation) -> None:
        self.count += 1


def test_a_row_counts_the_violations_of_its_attempt(lift_barrier: Task) -> None:
    """The loop itself counts: repaired, given up within the budget, and at the end of it."""
    bad, nothing = "no json", json.dumps({"Subgoals": {}})
    cases = [
        ((), True, 0),
        ((bad, bad), True, 2),
        ((nothing,), False, 0),
        ((bad, nothing), False, 1),
        ((bad, bad, nothing), False, 2),
        ((bad, bad, bad), False, 3),
    ]
    with Simulator(lift_barrier, render=False) as world:
        for answers, success, expected in cases:
            seen = Rejections()
            settings = Settings(lift_barrier, FULL, ScriptedSpec(), attempts=3)
            outcome = EpisodeMaker(settings, world, Answers(*answers), seen).make(0)
            row = generation_row(lift_barrier, FULL, "scripted", outcome)
            assert (row.success, row.violations) == (success, expected) == (outcome.success, seen.count)
            assert (row.contacts, row.generator) == (outcome.contacts, generator_version(lift_barrier))
