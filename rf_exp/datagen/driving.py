"""Monitored execution of plans, with controlled stops: for demonstrations, and for plans of the library.

To stop, the clock of the schedule slows down until all arms are at rest. They slow down together, so they
pass only through configurations of the schedule, and keep clear of one another as planned.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from rf_exp.coordination import pad_paths, scheduled_actions
from rf_exp.datagen.disturb import PERTURBATION_LIMITS
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.planning import Planned
from rf_exp.findings import CheckName, Violation
from rf_exp.types import CONTROL_DT_S, JointLimits, Scene, arm_of, fingers_of

MIN_PACE = 1e-3  # share of the planned pace; below it an arm counts as at rest
_PACE_CANDIDATES = 65  # candidates for each control step, from rest to the pace of the step before

Command = NDArray[np.float64]  # (N, A): joint targets in rad and grippers, for a control step
Commands = NDArray[np.float64]  # (K, N, A)


class Arms(Protocol):
    """All arms of a scene, which execute one command after the other."""

    @property
    def scene(self) -> Scene: ...  # last measured

    @property
    def last_command(self) -> Command | None: ...  # None before the first

    @property
    def finished(self) -> bool: ...  # whether execution is to end

    def step(self, command: Command) -> None: ...  # one control step


def plan_commands(plan: Planned) -> Commands:
    """(T + 1, N, A): the start of the arms, and the command of each control step of the plan."""
    return with_start(plan, scheduled_actions(plan.executed, plan.schedule))


def with_start(plan: Planned, commands: Commands) -> Commands:
    """Commands of a plan (T, N, A), preceded by a row for the start of its arms (T + 1, N, A)."""
    start = pad_paths([trajectory.path()[:1] for trajectory in plan.trajectories])
    return np.concatenate([np.stack(start, axis=1), commands])


def execute_commands(arms: Arms, commands: Commands) -> None:
    """Executes commands until `arms.finished`."""
    for command in commands:
        if arms.finished:
            break
        arms.step(command)


def execute_monitored(
    arms: Arms,
    commands: Commands,
    monitor: Callable[[Scene], Violation | None],
    limits: JointLimits,
    step: Callable[[int], None] | None = None,
    stop: Callable[[int], None] | None = None,
) -> Violation | None:
    """Executes the `plan_commands` until `arms.finished` or a violation of the monitor, which is returned.

    After a violation all arms come to rest along the plan, and arms in a collision stop pushing. `step`
    executes one row of the plan; by default the command of that row. `stop` brings the arms to rest after a
    row; by default along the commands.
    """
    step = step or (lambda row: arms.step(commands[row]))
    stop = stop or (lambda row: execute_commands(arms, come_to_rest(commands, row, limits)))
    for row in range(1, len(commands)):
        step(row)
        if arms.finished:
            break
        violation = monitor(arms.scene)
        if violation is not None:
            stop(row)
            if violation.check is CheckName.COLLISION and arms.last_command is not None:
                qpos, agents = arms.scene.qpos, violation.agents
                execute_commands(arms, relax_to_measured(arms.last_command, qpos, agents, limits))
            return violation
    return None


def at_last_command(scene: Scene, command: Command | None) -> Scene:
    """The scene with the arms at their last `command` (N, A); unchanged for None.

    Arms lag behind their targets a little; motion that began at the measured joints would jerk back.
    """
    if command is None:
        return scene
    return replace(scene, qpos=np.hstack([arm_of(command), fingers_of(scene.qpos)]))


def come_to_rest(commands: Commands, row: int, limits: JointLimits | Sequence[JointLimits]) -> Commands:
    """Commands (K, N, A) that follow `commands` (T, N, A) beyond `row`, ever slower until at rest.

    Row 0 of `commands` is the start of the arms. Velocity and acceleration of all joints stay within
    `limits`: one for all N arms, or one for each.
    """
    arm_limits = [limits] * commands.shape[1] if isinstance(limits, JointLimits) else limits
    allowed = np.repeat([each.acceleration_rad_s2 for each in arm_limits], commands.shape[2] - 1)
    times = np.arange(len(commands))
    path = CubicSpline(times, arm_of(commands).reshape(len(commands), -1))
    last_position, position = float(max(row - 1, 0)), float(row)
    last_qpos, qpos = path(last_position), path(position)
    rows = []
    while position - last_position > MIN_PACE:
        # Keeping the pace is always within the limits: the plan is, and slower is easier.
        paces = np.linspace(0.0, position - last_position, _PACE_CANDIDATES)
        ahead = np.minimum(position + paces, len(commands) - 1)
        accelerations = np.abs(path(ahead) - 2 * qpos + last_qpos) / CONTROL_DT_S**2
        excess = (accelerations / allowed).max(axis=1)
        feasible = np.flatnonzero(excess <= 1.0)
        choice = int(feasible[0]) if len(feasible) else int(np.argmin(excess))
        last_position, position = position, float(ahead[choice])
        last_qpos, qpos = qpos, path(position)
        arms = qpos.reshape(commands.shape[1], -1)
        rows.append(np.hstack([arms, commands[int(position), :, -1:]]))
    return np.array(rows).reshape(-1, *commands.shape[1:])


def come_to_rest_disturbed(
    intended: Commands, executed: Commands, row: int, limits: JointLimits
) -> tuple[Commands, Commands]:
    """`come_to_rest` of commands (T, N, A) whose execution is disturbed: (K, N, A) intended, and executed.

    Both follow one clock. The arms stay where they come to rest; the intended commands then lead there too,
    within `limits`.
    """
    agents = intended.shape[1]
    disturbed_limits = JointLimits(
        limits.velocity_rad_s + PERTURBATION_LIMITS.velocity_rad_s,
        limits.acceleration_rad_s2 + PERTURBATION_LIMITS.acceleration_rad_s2,
    )
    both = np.concatenate([intended, executed], axis=1)
    arm_limits = [limits] * agents + [disturbed_limits] * agents
    rows = np.concatenate([both[row][None], come_to_rest(both, row, arm_limits)])
    intended, executed = rows[:, :agents], rows[:, agents:]
    settling = relax_to_measured(intended[-1], executed[-1], range(1, agents + 1), limits)
    resting = np.tile(executed[-1], (len(settling), 1, 1))
    return np.concatenate([intended, settling])[1:], np.concatenate([executed, resting])[1:]


def relax_to_measured(
    command: Command, qpos: NDArray[np.float64], agents: Collection[int], limits: JointLimits
) -> Commands:
    """Commands (K, N, A) that move some agents from the present command (N, A) to their measured joints.

    Rows of `qpos` begin with the joints of the arm. An arm that is kept from following its command pushes; at
    its measured joints it no longer does.
    """
    commanded = arm_of(command)
    motions = {
        agent: parameterise(np.stack([commanded[agent - 1], qpos[agent - 1, : commanded.shape[1]]]), limits)
        for agent in agents
    }
    rows = np.tile(command, (max(map(len, motions.values()), default=0), 1, 1))
    for agent, points in motions.items():
        if len(points):
            indices = np.minimum(np.arange(len(rows)), len(points) - 1)  # the first to arrive waits
            arm_of(rows)[:, agent - 1] = points[indices]
    return rows
