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

from rf_exp.coordination import actions, alike
from rf_exp.datagen.disturb import ADDED
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.datagen.planning import Planned
from rf_exp.findings import CheckName, Violation
from rf_exp.types import CONTROL_DT_S, JointLimits, Scene, arm_of, fingers_of

SLOWEST = 1e-3  # share of the planned pace; below it an arm counts as at rest
_PACES = 65  # candidates for each control step, from rest to the pace of the step before

Command = NDArray[np.float64]  # (N, A): joint targets in rad and grippers, for a control step
Commands = NDArray[np.float64]  # (K, N, A)


class Arms(Protocol):
    """All arms of a scene, which execute one command after the other."""

    @property
    def scene(self) -> Scene: ...  # last measured

    @property
    def told(self) -> Command | None: ...  # the last command; None before the first

    @property
    def over(self) -> bool: ...  # whether execution is to end

    def take(self, command: Command) -> None: ...  # one control step


def commands_of(plan: Planned) -> Commands:
    """(T + 1, N, A): the start of the arms, and the command of each control step of the plan."""
    return from_start(plan, actions(plan.executed, plan.schedule))


def from_start(plan: Planned, commands: Commands) -> Commands:
    """Commands of a plan (T, N, A), preceded by a row for the start of its arms (T + 1, N, A)."""
    start = alike([trajectory.path()[:1] for trajectory in plan.trajectories])
    return np.concatenate([np.stack(start, axis=1), commands])


def follow(arms: Arms, commands: Commands) -> None:
    """Executes commands until `arms.over`."""
    for command in commands:
        if arms.over:
            break
        arms.take(command)


def drive(
    arms: Arms,
    commands: Commands,
    monitor: Callable[[Scene], Violation | None],
    limits: JointLimits,
    take: Callable[[int], None] | None = None,
    rest: Callable[[int], None] | None = None,
) -> Violation | None:
    """Executes the `commands_of` a plan until `arms.over` or a violation of the monitor, which is returned.

    After a violation all arms come to rest along the plan, and arms in a collision stop pushing. `take`
    executes one row of the plan; by default the command of that row. `rest` brings the arms to rest after a
    row; by default along the commands.
    """
    take = take or (lambda now: arms.take(commands[now]))
    rest = rest or (lambda now: follow(arms, come_to_rest(commands, now, limits)))
    for now in range(1, len(commands)):
        take(now)
        if arms.over:
            break
        violation = monitor(arms.scene)
        if violation is not None:
            rest(now)
            if violation.check is CheckName.COLLISION and arms.told is not None:
                follow(arms, let_off(arms.told, arms.scene.qpos, violation.agents, limits))
            return violation
    return None


def as_commanded(scene: Scene, command: Command | None) -> Scene:
    """The scene with the arms at their last `command` (N, A); unchanged for None.

    Arms lag behind their targets a little; motion that began at the measured joints would jerk back.
    """
    if command is None:
        return scene
    return replace(scene, qpos=np.hstack([arm_of(command), fingers_of(scene.qpos)]))


def come_to_rest(commands: Commands, now: int, limits: JointLimits | Sequence[JointLimits]) -> Commands:
    """Commands (K, N, A) that follow `commands` (T, N, A) beyond row `now`, ever slower until at rest.

    Row 0 of `commands` is the start of the arms. Velocity and acceleration of all joints stay within
    `limits`: one for all N arms, or one for each.
    """
    each = [limits] * commands.shape[1] if isinstance(limits, JointLimits) else limits
    allowed = np.repeat([of.acceleration_rad_s2 for of in each], commands.shape[2] - 1)
    times = np.arange(len(commands))
    path = CubicSpline(times, arm_of(commands).reshape(len(commands), -1))
    before, here = float(max(now - 1, 0)), float(now)
    q_before, q_here = path(before), path(here)
    rows = []
    while here - before > SLOWEST:
        # Keeping the pace is always within the limits: the plan is, and slower is easier.
        paces = np.linspace(0.0, here - before, _PACES)
        ahead = np.minimum(here + paces, len(commands) - 1)
        steep = np.abs(path(ahead) - 2 * q_here + q_before) / CONTROL_DT_S**2
        excess = (steep / allowed).max(axis=1)
        fits = np.flatnonzero(excess <= 1.0)
        chosen = int(fits[0]) if len(fits) else int(np.argmin(excess))
        before, here = here, float(ahead[chosen])
        q_before, q_here = q_here, path(here)
        arms = q_here.reshape(commands.shape[1], -1)
        rows.append(np.hstack([arms, commands[int(here), :, -1:]]))
    return np.array(rows).reshape(-1, *commands.shape[1:])


def come_to_rest_disturbed(
    meant: Commands, executed: Commands, now: int, limits: JointLimits
) -> tuple[Commands, Commands]:
    """`come_to_rest` of commands (T, N, A) whose execution is disturbed: (K, N, A) meant, and executed.

    Both follow one clock. The arms stay where they come to rest; the meant commands then lead there too,
    within `limits`.
    """
    size = meant.shape[1]
    added = JointLimits(
        limits.velocity_rad_s + ADDED.velocity_rad_s, limits.acceleration_rad_s2 + ADDED.acceleration_rad_s2
    )
    both = np.concatenate([meant, executed], axis=1)
    rows = np.concatenate([both[now][None], come_to_rest(both, now, [limits] * size + [added] * size)])
    meant, executed = rows[:, :size], rows[:, size:]
    arrives = let_off(meant[-1], executed[-1], range(1, size + 1), limits)
    stays = np.tile(executed[-1], (len(arrives), 1, 1))
    return np.concatenate([meant, arrives])[1:], np.concatenate([executed, stays])[1:]


def let_off(
    command: Command, qpos: NDArray[np.float64], agents: Collection[int], limits: JointLimits
) -> Commands:
    """Commands (K, N, A) that move some agents from the present command (N, A) to their measured joints.

    Rows of `qpos` begin with the joints of the arm. An arm that is kept from following its command pushes; at
    its measured joints it no longer does.
    """
    told = arm_of(command)
    motions = {
        agent: parameterise(np.stack([told[agent - 1], qpos[agent - 1, : told.shape[1]]]), limits)
        for agent in agents
    }
    rows = np.tile(command, (max(map(len, motions.values()), default=0), 1, 1))
    for agent, points in motions.items():
        if len(points):
            ends = np.minimum(np.arange(len(rows)), len(points) - 1)  # the first to arrive waits
            arm_of(rows)[:, agent - 1] = points[ends]
    return rows
