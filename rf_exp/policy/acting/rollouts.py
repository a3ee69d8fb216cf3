"""Rollout loop: policies act in a world at the control rate, each by its runner, judged at every step.

A policy is handed an observation of what it declares (`rf_exp.observations`); judge, monitor and shield,
which are no policies, see the scene. Observations have the history of training: consecutive control steps.
A predicted chunk is executed one target a control step; a target further away than the demonstrations ever
moved in a step is approached by linear interpolation in joint space (paper, supplementary "Evaluation
details"), so that a jump between two chunks becomes a motion at the demonstrations' speed. A shield may
stand between the policies and the arms (`rf_exp.policy.acting.shield`).
"""

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import protective_stop
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Violation
from rf_exp.observations import Declaration, Observation, observe
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.inputs.coordination import Coordinate
from rf_exp.policy.inputs.rows import narrow, widened
from rf_exp.policy.inputs.view import ACTION_SIZE, View
from rf_exp.tasks import Ledger
from rf_exp.types import (
    ARM_JOINTS,
    GRIPPER_OPEN,
    KeypointDetection,
    Rollout,
    RolloutStep,
    Scene,
    Verdict,
    World,
    joints_of,
)

# The scene and agent -> (T, 8) the commands that are about to be given -> those that are.
Shielding = Callable[[Scene, Mapping[int, NDArray[np.float64]]], Decision]


class Targets:
    """A queue of predicted targets for each agent of a runner, in the order of its view.

    A target further away than the demonstrations ever moved in a control step is approached by linear
    interpolation in joint space. An agent that was kept from its target has it still before it, so agents
    may have different numbers of them.
    """

    def __init__(self, fastest_rad: NDArray[np.float64]) -> None:
        self._fastest_rad = fastest_rad  # (agents,) a control step
        self._queues = [deque[NDArray[np.float64]]() for _ in fastest_rad]  # of (8,)
        self.last = np.empty((0, ARM_JOINTS))  # (agents, 7) arm targets given last, or where motion begins

    def __len__(self) -> int:
        """The targets left for the agent that has the fewest."""
        return min(map(len, self._queues))

    def start(self, qpos: NDArray[np.float64]) -> None:
        """Measured joints (agents, 9), where motion begins; nothing once it has begun."""
        if not len(self.last):
            self.last = qpos[:, :ARM_JOINTS]

    def put(self, chunk: NDArray[np.float64]) -> None:
        """Targets (T, agents, 8) from now on, instead of what was left."""
        self._queues = [deque(chunk[:, row]) for row in range(chunk.shape[1])]

    def forget(self, row: int) -> None:
        """Drop what is left for one agent, so that a prediction is due."""
        self._queues[row].clear()

    def ahead(self, steps: int | None = None) -> list[NDArray[np.float64]]:
        """The commands (T, 8) of each agent from this control step on, as they will be given."""
        found = []
        for queue, last, fastest in zip(self._queues, self.last, self._fastest_rad, strict=True):
            rows = []
            for target in list(queue)[:steps]:
                change = target[:ARM_JOINTS] - last
                part = fastest / np.maximum(np.abs(change).max(), fastest + 1e-12)  # at most 1
                last = last + part * change
                rows.append(np.append(last, np.clip(target[ARM_JOINTS], -1.0, 1.0)))
            found.append(np.array(rows))
        return found

    def given(self, commands: NDArray[np.float64], kept: Collection[int] = ()) -> None:
        """What was commanded, (agents, 8); the rows in `kept` were kept from their targets."""
        self.last = commands[:, :ARM_JOINTS].copy()
        for row, queue in enumerate(self._queues):
            if row not in kept:
                queue.popleft()


@dataclass
class RunnerState:
    """What a runner remembers of an episode, and what it says to others about it."""

    targets: Targets
    kept: bool = False  # whether an agent was kept from its target in the last step
    # agent -> (T, 8) targets predicted in the last call, from its step on; empty if it predicted nothing
    predicted: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    detections: tuple[KeypointDetection, ...] = ()  # in the last pictures
    # agent -> number of its subgoal and whether it may go on, as it said in the last prediction
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


class PolicyRunner:
    """Some agents that are given their targets in chunks, and what is common to all who predict them.

    At every control step it is handed an observation of what it `declares`, and nothing else of the scene.
    """

    def __init__(
        self, view: View, fastest_rad: NDArray[np.float64], declared: Declaration | None = None
    ) -> None:
        """`fastest_rad` (agents of the view,): the largest change of a joint in a control step.

        It observes what is `declared`, or the joints of its agents, which it needs in any case.
        """
        self.view, self._fastest_rad = view, fastest_rad
        self._declared = declared or Declaration(view.agents)
        self.state = RunnerState(Targets(fastest_rad))

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.state = RunnerState(Targets(self._fastest_rad))

    @property
    def looks(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return False

    @property
    def declares(self) -> Declaration:
        """What it is to be handed at this control step: without cameras, unless it looks."""
        return self._declared if self.looks else replace(self._declared, cameras=())

    def observe(self, observation: Observation) -> None:
        """Take in the present moment, at every control step and before a prediction."""

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """Targets (T, agents of the view, 8) from this control step on."""
        raise NotImplementedError

    def __call__(self, observation: Observation) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step."""
        self.think(observation)
        return self.act()

    def think(self, observation: Observation) -> None:
        """Observe, and predict where an agent has nothing left to do: then for all agents of the view."""
        self.state.predicted = {}
        self.state.targets.start(np.stack([observation.qpos[agent] for agent in self.view.agents]))
        self.observe(observation)
        if not self.state.targets:
            chunk = self.predict(observation)
            self.state.targets.put(chunk)
            self.state.predicted = {agent: chunk[:, row] for row, agent in enumerate(self.view.agents)}

    def ahead(self) -> dict[int, NDArray[np.float64]]:
        """Agent -> (T, 8) commands from this control step on, if nobody keeps it from them."""
        return dict(zip(self.view.agents, self.state.targets.ahead(), strict=True))

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step: its own, or what was decided."""
        agents = self.view.agents
        if decision is None:
            commands: NDArray[np.float64] = np.concatenate(self.state.targets.ahead(1))
            self.state.targets.given(commands)
            return commands
        commands = decision.commands[np.array(agents) - 1]
        kept = [row for row, agent in enumerate(agents) if agent in decision.withheld]
        self.state.targets.given(commands, kept)
        self.state.kept = bool(kept)
        for row, agent in enumerate(agents):
            if agent in decision.anew:
                self.state.targets.forget(row)
        return commands


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

    Strict success asks that no two arms have touched until then. It is over as well when two arms press so
    hard on one another that they stop by themselves.
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
    joints = joints_of(scene.qpos).shape[1]
    commanded = sorted(agent for runner in runners for agent in runner.view.agents)
    expected = list(range(1, len(scene.qpos) + 1))
    if commanded != expected:
        raise ArgumentError(f"the policies command agents {commanded}; expected each of {expected} once")
    for runner in runners:
        runner.reset(seed)

    action = np.zeros((len(scene.qpos), ACTION_SIZE))
    action[:, ARM_JOINTS] = GRIPPER_OPEN
    ledger, success_paper = Ledger(), False
    first: dict[tuple[int, ...], Violation] = {}  # agents -> their first violation
    steps = violations = interventions = 0  # control steps
    while steps < step_limit and not (ledger.success or protective_stop(scene)):
        declared = [_declared(world, runner) for runner in runners]
        shown = widened(scene)
        said = coordinate(shown, dict(enumerate(action[:, ARM_JOINTS], start=1))) if coordinate else None
        for runner, seen in zip(runners, observe(shown, world, declared, said), strict=True):
            runner.think(seen)
        decision = None
        if shield is not None:
            decision = shield(shown, {k: rows for runner in runners for k, rows in runner.ahead().items()})
        for runner in runners:
            action[np.array(runner.view.agents) - 1] = runner.act(decision)
        scene = world.step(narrow(action.copy(), joints))
        states, verdict = [runner.state for runner in runners], judge(scene)
        violation = None if monitor is None else monitor(scene)
        withheld = None if decision is None else decision.withheld
        steps += 1
        ledger.see(scene, verdict)
        success_paper |= verdict.success_paper
        interventions += bool(withheld)
        if violation is not None:
            violations += 1
            first.setdefault(violation.agents, violation)
        if on_step is not None:
            step = RolloutStep(
                scene,
                narrow(action.copy(), joints),
                {agent: narrow(chunk, joints) for each in states for agent, chunk in each.predicted.items()},
                verdict,
                violation,
                withheld,
                tuple(each for state in states for each in state.detections),
                {agent: phase for state in states for agent, phase in state.phases.items()},
            )
            on_step(step)
    account = replace(ledger.account(ledger.success), violations=tuple(first.values()))
    return Rollout(
        seed, ledger.success, success_paper, steps, violations, ledger.contacts, account, interventions
    )


def _declared(world: World, runner: PolicyRunner) -> Declaration:
    """What a runner needs now. Raises StageError for a camera that the world does not have."""
    declared = runner.declares
    for camera in declared.cameras:
        if camera not in world.cameras:
            known = ", ".join(sorted(world.cameras)) or "none"
            raise StageError(f"policy {runner.view.name!r} needs camera {camera!r}; the world has {known}")
    return declared
