"""The RoboBrain that knows the language and nothing else: legal subgoals and constraints, drawn at random.

What it reaches is what luck reaches, beside which a model's figures can be read.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rf_exp.datagen.brain.legal import Legal, legal
from rf_exp.datagen.brain.protocol import BrainSpec, Question, to_json
from rf_exp.statements import VERBS, Proposal
from rf_exp.tasks import Task
from rf_exp.types import PROPOSALS, ConstraintSet, Subgoal

LONGEST = 3  # subgoals of an agent in one answer
MOST = 4  # constraints of an answer


class RandomBrain:
    """Draws every answer anew, whatever has been found wrong with the last one."""

    name = "random"

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, PROPOSALS])

    def answer(self, question: Question) -> str:
        known, rng = legal(question.task, question.scene), self._rng
        held = zip(question.task.agents, question.scene.held, strict=True)
        subgoals = [each for agent, name in held for each in self._queue(agent, name, known)]
        fitting = known.fitting(subgoals)
        drawn = rng.permutation(len(fitting))[: int(rng.integers(MOST + 1))]
        return to_json(Proposal(tuple(subgoals), tuple(fitting[at] for at in sorted(drawn))))

    def _queue(self, agent: int, held: str | None, known: Legal) -> Iterator[Subgoal]:
        """Up to LONGEST subgoals of an agent, each of which its hand allows after the one before."""
        before = None
        for _ in range(int(self._rng.integers(1, LONGEST + 1))):
            options = [each for each in known.subgoals[agent] if each != before and _allows(held, each)]
            before = options[int(self._rng.integers(len(options)))]
            yield before
            if before.verb == "grasp":
                held = before.object
            elif before.verb in ("place", "release"):
                held = None


def _allows(held: str | None, subgoal: Subgoal) -> bool:
    """Whether a hand that holds something, or nothing, can do it."""
    if subgoal.object is None:
        return True
    return held is None if VERBS[subgoal.verb].is_contact else held == subgoal.object


@dataclass(frozen=True)
class RandomSpec(BrainSpec):
    """`brain=random`."""

    name: ClassVar[str] = "random"

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> RandomBrain:
        return RandomBrain(seed)
