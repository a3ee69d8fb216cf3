"""The Gymnasium face: one controller of all arms."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rf_exp.envs.core import METADATA, EpisodeCore, Face
from rf_exp.envs.observations import action_space, space
from rf_exp.observations import ObservationDict, Observations
from rf_exp.tasks import NONE, Task, Variation


class CentralEnv(Face, gymnasium.Env[ObservationDict, NDArray[np.floating]]):
    """A task for one controller of all N arms; `gymnasium.make("rf_exp/<task>-v1")` makes it.

    Actions (N, A) float32: absolute joint targets in rad and the gripper in [-1 closed, 1 open] an
    arm, beyond their limits clipped. Observations: a dictionary as `Observations` says, with (N, D) joints
    in rad and m, (N, D) velocities, (7,) positions in m and quaternions (w, x, y, z) in the world. Reward: 1
    for success by the strict criterion, which ends the episode, else 0. Arguments and errors are those of
    `EpisodeCore`.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str | Path | Task,
        observations: Observations | None = None,
        *,
        variation: str | Variation = NONE,
        step_limit: int | None = None,
        overlaps: bool = False,
        render_mode: str | None = None,
    ) -> None:
        how = {"step_limit": step_limit, "overlaps": overlaps, "render_mode": render_mode}
        self.core = EpisodeCore(task, observations, variation=variation, **how)
        self.render_mode = render_mode
        self.action_space: spaces.Box = action_space(self.task)
        self.observation_space: spaces.Dict = space(self.core.observations, self.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """The scene of exactly this seed, as in the rest of the suite; else the next from `np_random`.

        `info["seed"]` tells which. There are no `options`. Raises ArgumentError for seeds from 2**32 on.
        """
        super().reset(seed=seed)
        self.core.reset(seed, self.np_random)
        return self.core.observe(), self.core.episode.info()

    def step(self, action: NDArray[np.floating]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """One control step, 50 ms: observation, reward, terminated, truncated, info."""
        self.core.step(action)
        now = self.core.episode
        return self.core.observe(), now.reward, now.success, now.truncated, now.info()
