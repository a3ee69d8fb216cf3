"""Arms driven along plans, watched and stopped: for demonstrations, and for plans of the library.

To stop, the clock of the schedule slows down until nobody moves. All arms slow down together, so they pass
only through configurations that the schedule has them pass through, and keep clear of one another as planned.
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

SLOWEST = 1e-3  # of the planned pace: less than this is rest
_PACES = 65  # tried for each control step, from standing still to the pace of the step before

Command = NDArray[np.float64]  # (N, A): joint targets in rad and grippers, for a control step
Commands = NDArray[np.float64]  # (K, N, A)


class Arms(Protocol):
    """All arms of a scene, which take one command after the other."""

    @property
    def scene(self) -> Scene: ...  # as it was measured last

    @property
    def told(self) -> Command | None: ...  # the last command; None before the first

    @property
    def over(self) -> bool: ...  # whether they are to take no more

    def take(self, command: Command) -> None: ...  # one control step


def commands_of(plan: Planned) -> Commands:
    """(T + 1, N, A): where the arms begin, and what the plan sends them in each control step."""
    return from_start(plan, actions(plan.executed, plan.schedule))


def from_start(plan: Planned, commands: Commands) -> Commands:
    """Commands of a plan (T, N, A) behind a row of where its arms begin (T + 1, N, A)."""
    start = alike([trajectory.path()[:1] for trajectory in plan.trajectories])
    return np.concatenate([np.stack(start, axis=1), commands])


def follow(arms: Arms, commands: Commands) -> None:
    """Carries out commands until it is over."""
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
    """Carries out the `commands_of` a plan until it is over, or its monitor objects to a control step.

    Then everybody comes to rest along the plan, and arms that have hit something no longer push. `take` takes
    a step of the plan, by its row; without it the command of that row is taken. `rest` comes to rest after a
    row; without it the commands do.
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
    """The scene with the arms where `command` (N, A) has sent them last; as it is where there was none.

    They trail their targets a little; motion that began at the measured joints would jerk back.
    """
    if command is None:
        return scene
    return replace(scene, qpos=np.hstack([arm_of(command), fingers_of(scene.qpos)]))


def come_to_rest(commands: Commands, now: int, limits: JointLimits | Sequence[JointLimits]) -> Commands:
    """Commands (K, N, A) that follow `commands` (T, N, A) beyond row `now` ever slower, and end at rest.

    Row 0 of `commands` is where the arms stood before the first of them. Nowhere is a joint faster or
    accelerated more than `limits` allow, of all of the N or of each.
    """
    each = [limits] * commands.shape[1] if isinstance(limits, JointLimits) else limits
    allowed = np.repeat([of.acceleration_rad_s2 for of in each], commands.shape[2] - 1)
    times = np.arange(len(commands))
    path = CubicSpline(times, arm_of(commands).reshape(len(commands), -1))
    before, here = float(max(now - 1, 0)), float(now)
    q_before, q_here = path(before), path(here)
    rows = []
    while here - before > SLOWEST:
        # To go on at the same pace is always within the limits: the plan is, and slower is easier.
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
    """`come_to_rest` of commands (T, N, A) that are executed otherwise than meant: (K, N, A) of each.

    Both follow one clock. Where the arms have come to rest they stay, and that is where they are meant to be
    in the end: what is meant goes there within `limits`.
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
    """Commands (K, N, A) that take some agents from the present command (N, A) to where they were measured.

    `qpos` has the joints of the arms first. An arm that was kept from following its command pushes; there it
    no longer does.
    """
    told = arm_of(command)
    motions = {
        agent: parameterise(np.stack([told[agent - 1], qpos[agent - 1, : told.shape[1]]]), limits)
        for agent in agents
    }
    rows = np.tile(command, (max(map(len, motions.values()), default=0), 1, 1))
    for agent, points in motions.items():
        if len(points):
            ends = np.minimum(np.arange(len(rows)), len(points) - 1)  # who is there first waits
            arm_of(rows)[:, agent - 1] = points[ends]
    return rows
