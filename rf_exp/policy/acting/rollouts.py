"""Rollout loop: policies act in a world at the control rate, judged at every step.

A policy is handed an observation of what it declares (`rf_exp.observations`); judge, monitor and shield,
which are no policies, see the scene. Observations have the history of training: consecutive control steps.
A predicted chunk is executed one target a control step; a target further away than the demonstrations ever
moved in a step is approached by linear interpolation in joint space (paper, supplementary "Evaluation
details"), so that a jump between two chunks becomes a motion at the demonstrations' speed. A shield may
stand between the policies and the arms (`rf_exp.policy.acting.shield`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Violation
from rf_exp.observations import Declaration, observe
from rf_exp.policy.acting.runner import PolicyRunner
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.inputs.coordination import Coordinate
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.tasks import Ledger
from rf_exp.types import ARM_JOINTS, GRIPPER_OPEN, Rollout, RolloutStep, Scene, Verdict, World

# The scene and agent -> (T, 8) the commands that are about to be given -> those that are.
Shielding = Callable[[Scene, Mapping[int, NDArray[np.float64]]], Decision]


def rollout(
    world: World,
    judge: Callable[[Scene], Verdict],
    runners: Sequence[PolicyRunner],
    seed: int,
    step_limit: int,
    monitor: Callable[[Scene], Violation | None] | None = None,
    on_step: Callable[[RolloutStep], None] | None = None,
    start: Scene | None = None,
    shield: Shielding | None = None,
    coordinate: Coordinate | None = None,
) -> Rollout:
    """Let the runners act in the scene of `seed` until strict success or for `step_limit` control steps.

    `judge` and `monitor` see the scene after every step, `on_step` is told of all that happened in it.
    `success_paper` is whether the paper's criterion held at any step. `start` is the scene of
    `world.reset(seed)` where the caller has just done that (a judge needs it). `shield`, of this rollout
    alone, sees before every step the scene and agent -> (T, 8) the commands that the runners are about to
    give, and decides which are given. `coordinate`, of this rollout alone, tells coordinated policies who is
    at which subgoal and who waits. Raises ArgumentError unless the runners command each agent exactly once.
    """
    if step_limit < 1:
        raise ArgumentError(f"step_limit is {step_limit}; expected at least 1")
    scene = world.reset(seed) if start is None else start
    commanded = sorted(agent for runner in runners for agent in runner.view.agents)
    expected = list(range(1, len(scene.qpos) + 1))
    if commanded != expected:
        raise ArgumentError(f"the policies command agents {commanded}; expected each of {expected} once")
    for runner in runners:
        runner.reset(seed)

    action = np.zeros((len(scene.qpos), ACTION_SIZE))
    action[:, ARM_JOINTS] = GRIPPER_OPEN
    tally = _Tally()
    while tally.steps < step_limit and not tally.success:
        declared = [_declared(world, runner) for runner in runners]
        said = coordinate(scene, dict(enumerate(action[:, ARM_JOINTS], start=1))) if coordinate else None
        for runner, seen in zip(runners, observe(scene, world, declared, said), strict=True):
            runner.think(seen)
        decision = None
        if shield is not None:
            decision = shield(scene, {k: rows for runner in runners for k, rows in runner.ahead().items()})
        for runner in runners:
            action[np.array(runner.view.agents) - 1] = runner.act(decision)
        scene = world.step(action.copy())
        states, verdict = [runner.state for runner in runners], judge(scene)
        step = RolloutStep(
            scene,
            action.copy(),
            {agent: chunk for state in states for agent, chunk in state.predicted.items()},
            verdict,
            None if monitor is None else monitor(scene),
            None if decision is None else decision.withheld,
            tuple(each for state in states for each in state.detections),
            {agent: phase for state in states for agent, phase in state.phases.items()},
        )
        tally.see(step)
        if on_step is not None:
            on_step(step)
    return tally.result(seed)


class _Tally:
    """What a rollout has come to so far."""

    def __init__(self) -> None:
        self.steps, self.success = 0, False
        self._success_paper = False
        self._violations = self._interventions = 0  # control steps
        self._first: dict[tuple[int, ...], Violation] = {}  # agents -> their first violation
        self._ledger = Ledger()

    def see(self, step: RolloutStep) -> None:
        self.steps += 1
        self.success = step.verdict.success
        self._success_paper |= step.verdict.success_paper
        self._interventions += bool(step.withheld)
        self._ledger.see(step.scene, step.verdict)
        if step.violation is not None:
            self._violations += 1
            self._first.setdefault(step.violation.agents, step.violation)

    def result(self, seed: int) -> Rollout:
        return Rollout(
            seed,
            self.success,
            self._success_paper,
            self.steps,
            self._violations,
            self._ledger.contacts,
            replace(self._ledger.account(), violations=tuple(self._first.values())),
            self._interventions,
        )


def _declared(world: World, runner: PolicyRunner) -> Declaration:
    """What a runner needs now. Raises StageError for a camera that the world does not have."""
    declared = runner.declares
    for camera in declared.cameras:
        if camera not in world.cameras:
            known = ", ".join(sorted(world.cameras)) or "none"
            raise StageError(f"policy {runner.view.name!r} needs camera {camera!r}; the world has {known}")
    return declared
