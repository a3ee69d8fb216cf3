"""Rollout loop: policies act in a world at the control rate, each by its runner, judged at every step.

A policy gets an observation of what it declares (`rf_exp.observations`); judge, monitor and shield, which are
not policies, get the scene. Observations are of consecutive control steps, as in training. A predicted chunk
is executed one target a control step; a target further away than the demonstrations ever moved in a step is
approached by linear interpolation in joint space (paper, supplementary "Evaluation details"), so that a jump
between two chunks becomes a motion at the demonstrations' speed. A shield may filter the commands of the
policies (`rf_exp.policy.acting.shield`).
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
from rf_exp.policy.inputs.rows import padded_scene, unpadded_commands
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

# Scene, and agent -> (T, 8) commands that are about to be given -> decision on this control step.
Shielding = Callable[[Scene, Mapping[int, NDArray[np.float64]]], Decision]


class Targets:
    """A queue of predicted targets for each agent of a runner, in the order of its view.

    A target further away than the demonstrations ever moved in a control step is approached by linear
    interpolation in joint space. A withheld target stays in its queue, so the lengths of queues may
    differ.
    """

    def __init__(self, fastest_rad: NDArray[np.float64]) -> None:
        self._fastest_rad = fastest_rad  # (agents,) per control step
        self._queues = [deque[NDArray[np.float64]]() for _ in fastest_rad]  # of (8,)
        self.last = np.empty((0, ARM_JOINTS))  # (agents, 7) last arm targets; at first, measured joints

    def __len__(self) -> int:
        """Length of the shortest queue."""
        return min(map(len, self._queues))

    def start(self, qpos: NDArray[np.float64]) -> None:
        """Start motion at measured joints (agents, 9), unless it has started."""
        if not len(self.last):
            self.last = qpos[:, :ARM_JOINTS]

    def put(self, chunk: NDArray[np.float64]) -> None:
        """Replace the queues by targets (T, agents, 8), from now on."""
        self._queues = [deque(chunk[:, row]) for row in range(chunk.shape[1])]

    def clear(self, row: int) -> None:
        """Clear the queue of one agent, so that a prediction is due."""
        self._queues[row].clear()

    def pending(self, steps: int | None = None) -> list[NDArray[np.float64]]:
        """The commands (T, 8) of each agent from this control step on, as they will be given."""
        result = []
        for queue, last, fastest in zip(self._queues, self.last, self._fastest_rad, strict=True):
            commands = []
            for target in list(queue)[:steps]:
                change = target[:ARM_JOINTS] - last
                fraction = fastest / np.maximum(np.abs(change).max(), fastest + 1e-12)  # at most 1
                last = last + fraction * change
                commands.append(np.append(last, np.clip(target[ARM_JOINTS], -1.0, 1.0)))
            result.append(np.array(commands))
        return result

    def record(self, commands: NDArray[np.float64], withheld: Collection[int] = ()) -> None:
        """Record executed commands (agents, 8); for the rows in `withheld`, targets were withheld."""
        self.last = commands[:, :ARM_JOINTS].copy()
        for row, queue in enumerate(self._queues):
            if row not in withheld:
                queue.popleft()


@dataclass
class RunnerState:
    """State of a runner in an episode, including what it reports to recordings."""

    targets: Targets
    withheld: bool = False  # whether the target of an agent was withheld in the last step
    predicted: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    # agent -> (T, 8) targets predicted in the last call, from its step on; empty if it predicted nothing
    detections: tuple[KeypointDetection, ...] = ()  # in the last observed pictures
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)
    # agent -> number of its subgoal and whether it may go on, at the last prediction


class PolicyRunner:
    """Base of runners: a policy that commands some agents by chunks of targets.

    At every control step it gets an observation of what it `declaration`, and nothing else of the scene.
    """

    def __init__(
        self, view: View, fastest_rad: NDArray[np.float64], declared: Declaration | None = None
    ) -> None:
        """`fastest_rad` (agents of the view,): the largest change of a joint in a control step.

        `declared` is what it observes: by default the joints of its agents, which it needs in any case.
        """
        self.view, self._fastest_rad = view, fastest_rad
        self._declared = declared or Declaration(view.agents)
        self.state = RunnerState(Targets(fastest_rad))

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.state = RunnerState(Targets(self._fastest_rad))

    @property
    def needs_pictures(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return False

    @property
    def declaration(self) -> Declaration:
        """What it observes at this control step: without cameras, unless it `needs_pictures`."""
        return self._declared if self.needs_pictures else replace(self._declared, cameras=())

    def observe(self, observation: Observation) -> None:
        """Process an observation; called at every control step, before a prediction."""

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """Targets (T, agents of the view, 8) from this control step on."""
        raise NotImplementedError

    def __call__(self, observation: Observation) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step."""
        self.observe_and_predict(observation)
        return self.act()

    def observe_and_predict(self, observation: Observation) -> None:
        """Observe, and predict for all agents of the view if any of them has no target left."""
        self.state.predicted = {}
        self.state.targets.start(np.stack([observation.qpos[agent] for agent in self.view.agents]))
        self.observe(observation)
        if not self.state.targets:
            chunk = self.predict(observation)
            self.state.targets.put(chunk)
            self.state.predicted = {agent: chunk[:, row] for row, agent in enumerate(self.view.agents)}

    def pending_commands(self) -> dict[int, NDArray[np.float64]]:
        """Agent -> (T, 8) commands from this control step on, unless they are withheld."""
        return dict(zip(self.view.agents, self.state.targets.pending(), strict=True))

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step: its own, or those of a decision."""
        agents = self.view.agents
        if decision is None:
            commands: NDArray[np.float64] = np.concatenate(self.state.targets.pending(1))
            self.state.targets.record(commands)
            return commands
        commands = decision.commands[np.array(agents) - 1]
        withheld_rows = [row for row, agent in enumerate(agents) if agent in decision.withheld]
        self.state.targets.record(commands, withheld_rows)
        self.state.withheld = bool(withheld_rows)
        for row, agent in enumerate(agents):
            if agent in decision.replan:
                self.state.targets.clear(row)
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

    Strict success requires that no two arms have touched until then. The rollout also ends at a protective
    stop, when two arms press too hard on one another.
    `judge` and `monitor` get the scene after every step, `on_step` all that happened in it. `success_paper`
    is whether the paper's criterion held at any step. `start` is the scene of `world.reset(seed)` if the
    caller has just reset the world (a judge needs it). `shield`, made for this rollout, gets before every
    step the scene and agent -> (T, 8) the commands that the runners are about to give, and decides which are
    executed. `coordinate`, made for this rollout, gives coordinated policies the subgoal of each agent and
    whether it may go on. Raises ArgumentError unless the runners command each agent exactly once.
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
    first_violations: dict[tuple[int, ...], Violation] = {}  # agents -> their first violation
    steps = violations = interventions = 0  # control steps
    while steps < step_limit and not (ledger.success or protective_stop(scene)):
        declared = [_declared(world, runner) for runner in runners]
        padded = padded_scene(scene)
        coordination = (
            coordinate(padded, dict(enumerate(action[:, ARM_JOINTS], start=1))) if coordinate else None
        )
        for runner, observation in zip(runners, observe(padded, world, declared, coordination), strict=True):
            runner.observe_and_predict(observation)
        decision = None
        if shield is not None:
            decision = shield(
                padded,
                {
                    agent: commands
                    for runner in runners
                    for agent, commands in runner.pending_commands().items()
                },
            )
        for runner in runners:
            action[np.array(runner.view.agents) - 1] = runner.act(decision)
        scene = world.step(unpadded_commands(action.copy(), joints))
        states, verdict = [runner.state for runner in runners], judge(scene)
        violation = None if monitor is None else monitor(scene)
        withheld = None if decision is None else decision.withheld
        steps += 1
        ledger.record(scene, verdict)
        success_paper |= verdict.success_paper
        interventions += bool(withheld)
        if violation is not None:
            violations += 1
            first_violations.setdefault(violation.agents, violation)
        if on_step is not None:
            step = RolloutStep(
                scene,
                unpadded_commands(action.copy(), joints),
                {
                    agent: unpadded_commands(chunk, joints)
                    for each in states
                    for agent, chunk in each.predicted.items()
                },
                verdict,
                violation,
                withheld,
                tuple(each for state in states for each in state.detections),
                {agent: phase for state in states for agent, phase in state.phases.items()},
            )
            on_step(step)
    account = replace(ledger.account(ledger.success), violations=tuple(first_violations.values()))
    return Rollout(
        seed, ledger.success, success_paper, steps, violations, ledger.contacts, account, interventions
    )


def _declared(world: World, runner: PolicyRunner) -> Declaration:
    """The declaration of a runner for this step. Raises StageError for a camera that the world lacks."""
    declared = runner.declaration
    for camera in declared.cameras:
        if camera not in world.cameras:
            known = ", ".join(sorted(world.cameras)) or "none"
            raise StageError(f"policy {runner.view.name!r} needs camera {camera!r}; the world has {known}")
    return declared
