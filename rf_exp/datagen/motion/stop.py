"""Between plans: stopping amid one, and where the next begins.

To stop, the clock of the schedule slows down until nobody moves. All arms slow down together, so they pass
only through configurations that the schedule has them pass through, and keep clear of one another as planned.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from rf_exp.datagen.motion.disturb import ADDED
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.types import CONTROL_DT_S, JointLimits, Scene, arm_of, fingers_of

SLOWEST = 1e-3  # of the planned pace: less than this is rest
_PACES = 65  # tried for each control step, from standing still to the pace of the step before


def as_commanded(scene: Scene, command: NDArray[np.float64] | None) -> Scene:
    """The scene with the arms where `command` (N, A) has sent them last; as it is where there was none.

    They trail their targets a little; motion that began at the measured joints would jerk back.
    """
    if command is None:
        return scene
    return replace(scene, qpos=np.hstack([arm_of(command), fingers_of(scene.qpos)]))


def come_to_rest(
    commands: NDArray[np.float64], now: int, limits: JointLimits | Sequence[JointLimits]
) -> NDArray[np.float64]:
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
    meant: NDArray[np.float64], executed: NDArray[np.float64], now: int, limits: JointLimits
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    command: NDArray[np.float64], qpos: NDArray[np.float64], agents: Collection[int], limits: JointLimits
) -> NDArray[np.float64]:
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
