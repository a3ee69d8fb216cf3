"""RoboBrains that need no network: the plan of the task's module, the same with one fault, random answers.

A fault has a name (`faults.py`), so that its detection and repair can be measured. The first answer that
admits it is the scripted plan with the fault in it. After RoboChecker's objection the answer is as scripted.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rf_exp.datagen.brain.faults import FAULTS, fault_named
from rf_exp.datagen.brain.legal import LegalAnswers, legal_answers
from rf_exp.datagen.brain.protocol import BrainSpec, Question, to_json
from rf_exp.datagen.yielding import yielding_agents, yielding_proposal
from rf_exp.errors import ArgumentError
from rf_exp.statements import VERBS, Proposal
from rf_exp.tasks import Task
from rf_exp.types import DISTURBANCES, PROPOSALS, ConstraintSet, Scene, Subgoal

_TRIED_SEEDS = range(4)  # seeds of the scenes tried for whether a fault applies
MAX_SUBGOALS = 3  # subgoals of an agent in one random answer
MAX_CONSTRAINTS = 4  # constraints in one random answer


class ScriptedBrain:
    """Answers with the task's own plan for the present scene, once arms in the way have yielded."""

    name = "scripted"

    def answer(self, question: Question) -> str:
        proposal = question.task.module.plan(question.scene, question.task)
        for violation in question.feedback:
            if agents := yielding_agents(violation, proposal, question.task, question.scene):
                return to_json(yielding_proposal(agents, question.task))
        return to_json(proposal)


@dataclass(frozen=True)
class ScriptedSpec(BrainSpec):
    """`brain=scripted`."""

    name: ClassVar[str] = "scripted"

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> ScriptedBrain:
        return ScriptedBrain()


def fault_applies(fault: str, task: Task, scene: Scene) -> bool:
    """Whether the scripted plan for the scene admits the fault."""
    question = Question(task, scene, {})
    proposal = task.module.plan(scene, task)
    return fault_named(fault).change(proposal, question, np.random.default_rng(0)) is not None


def faults_for(task: Task) -> tuple[str, ...]:
    """The faults that a first or second proposal of the scripted plan admits, in some scene."""
    applicable: set[str] = set()
    for seed in _TRIED_SEEDS:
        start = task.start(seed).scene
        for scene in (start, _with_grasps(task, start)):
            remaining = [fault for fault in FAULTS if fault not in applicable]
            applicable |= {fault for fault in remaining if fault_applies(fault, task, scene)}
    return tuple(fault for fault in FAULTS if fault in applicable)


def _with_grasps(task: Task, scene: Scene) -> Scene:
    """The scene with every agent holding what it last grasps and does not put down in the scripted plan."""
    held: dict[int, str | None] = {}
    for subgoal in task.module.plan(scene, task).subgoals:
        held[subgoal.agent] = subgoal.object if subgoal.verb not in ("place", "release") else None
    return replace(scene, held=tuple(held.get(agent) for agent in task.agents))


class FaultyBrain:
    """Scripted brain with one fault. `inserted` tells whether the fault has been made in this episode."""

    name = "faulty"

    def __init__(self, fault: str, seed: int) -> None:
        self.fault = fault_named(fault)
        self._rng = np.random.default_rng([seed, DISTURBANCES])
        self.inserted = self._corrected = False

    def answer(self, question: Question) -> str:
        if not self.inserted and not question.feedback:
            proposal = question.task.module.plan(question.scene, question.task)
            faulty = self.fault.change(proposal, question, self._rng)
            if faulty is not None:
                self.inserted = True
                return to_json(faulty)
        if self.inserted and not self._corrected:
            # The first feedback is about the fault, and the plan without it is the answer.
            self._corrected, question = True, replace(question, feedback=())
        return ScriptedBrain().answer(question)


@dataclass(frozen=True)
class FaultySpec(BrainSpec):
    """`brain=faulty`."""

    name: ClassVar[str] = "faulty"

    fault: str

    def __post_init__(self) -> None:
        fault_named(self.fault)

    @property
    def label(self) -> str:
        return f"{self.name}+{self.fault}"

    @property
    def identity(self) -> dict[str, object]:
        return {"name": self.name, "fault": self.fault}

    def fits(self, task: Task) -> None:
        """Raises ArgumentError for a task whose plans do not admit the fault."""
        if self.fault not in (known := faults_for(task)):
            raise ArgumentError(
                f"brain.fault={self.fault} has no place in the plans of {task.name}; "
                f"those that have: {', '.join(known)}"
            )

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> FaultyBrain:
        return FaultyBrain(self.fault, seed)


class RandomBrain:
    """Draws legal subgoals and constraints anew for every answer: the baseline of chance."""

    name = "random"

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, PROPOSALS])

    def answer(self, question: Question) -> str:
        legal, rng = legal_answers(question.task, question.scene), self._rng
        grippers = zip(question.task.agents, question.scene.held, strict=True)
        subgoals = [each for agent, name in grippers for each in self._random_subgoals(agent, name, legal)]
        fitting = legal.fitting(subgoals)
        choice = rng.permutation(len(fitting))[: int(rng.integers(MAX_CONSTRAINTS + 1))]
        return to_json(Proposal(tuple(subgoals), tuple(fitting[k] for k in sorted(choice))))

    def _random_subgoals(self, agent: int, held: str | None, legal: LegalAnswers) -> Iterator[Subgoal]:
        """Up to LONGEST subgoals of an agent, each possible with what its gripper then holds."""
        last = None
        for _ in range(int(self._rng.integers(1, MAX_SUBGOALS + 1))):
            others = (subgoal for subgoal in legal.subgoals[agent] if subgoal != last)
            options = [subgoal for subgoal in others if _can_carry_out(held, subgoal)]
            last = options[int(self._rng.integers(len(options)))]
            yield last
            if last.verb == "grasp":
                held = last.object
            elif last.verb in ("place", "release"):
                held = None


def _can_carry_out(held: str | None, subgoal: Subgoal) -> bool:
    """Whether a gripper that holds an object, or nothing, can carry out the subgoal."""
    if subgoal.object is None:
        return True
    return held is None if VERBS[subgoal.verb].is_contact else held == subgoal.object


@dataclass(frozen=True)
class RandomSpec(BrainSpec):
    """`brain=random`."""

    name: ClassVar[str] = "random"

    def make(self, task: Task, constraint_set: ConstraintSet, seed: int) -> RandomBrain:
        return RandomBrain(seed)
