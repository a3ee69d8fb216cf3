"""Gymnasium environment for one controller of all arms, and registration of the environments."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rf_exp.envs.core import METADATA, BaseEnv, find_task, task_names
from rf_exp.envs.observations import action_space, observation_space
from rf_exp.errors import StageError
from rf_exp.observations import ObservationDict, Observations
from rf_exp.tasks import Task

if TYPE_CHECKING:
    from rf_exp.envs.parallel import ParallelArmsEnv

VERSION = 1  # of the interface: raise it when the meaning of observations, actions or reward changes


class CentralEnv(BaseEnv, gymnasium.Env[ObservationDict, NDArray[np.floating]]):
    """Gymnasium environment of a task for one controller of all N arms: `gymnasium.make("rf_exp/<task>-v1")`.

    Actions (N, A) float32: absolute joint targets in rad and the gripper in [-1 closed, 1 open] per arm,
    clipped to their limits. Observations: a dictionary selected by `Observations`, with (N, D) joints in rad
    and m, (N, D) velocities, (7,) positions in m and quaternions (w, x, y, z) in the world. Reward: 1 for
    success by the strict criterion, which ends the episode, else 0. Arguments and errors are those of
    `EpisodeCore`.
    """

    metadata = METADATA

    def __init__(
        self, task: str | Path | Task, observations: Observations | None = None, **options: Any
    ) -> None:
        super().__init__(task, observations, **options)
        self.action_space: spaces.Box = action_space(self.task)
        self.observation_space: spaces.Dict = observation_space(self.core.observations, self.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Resets to the scene of exactly this seed, as in the rest of the suite, or of one from `np_random`.

        `info["seed"]` is the seed. `options` are ignored. Raises ArgumentError for seeds from 2**32 on.
        """
        super().reset(seed=seed)
        self.core.reset(seed, self.np_random)
        return self.core.observe(), self.core.episode.info()

    def step(self, action: NDArray[np.floating]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """One control step, 50 ms: observation, reward, terminated, truncated, info."""
        self.core.step(action)
        episode = self.core.episode
        return self.core.observe(), episode.reward, episode.terminated, episode.truncated, episode.info()


def environment_id(name: str) -> str:
    """Gymnasium ID of a task's environment."""
    return f"rf_exp/{name}-v{VERSION}"


def register(path: str | Path) -> str:
    """Registers the task of a YAML file with Gymnasium; returns the ID for `gymnasium.make`.

    Modules that it names (`code`, assets) must be importable. Raises ArgumentError as `find_task`.
    """
    return _register(find_task(Path(path)).name, str(Path(path).resolve()))


def _register(name: str, task: str) -> str:
    gymnasium.register(
        environment_id(name), entry_point="rf_exp.envs.central:CentralEnv", kwargs={"task": task}
    )
    return environment_id(name)


for _name in task_names():
    _register(_name, _name)


def parallel_env(
    task: str | Path | Task, observations: Observations | None = None, **options: Any
) -> "ParallelArmsEnv":
    """The PettingZoo environment of a task: its name, the path of its YAML file, or itself.

    `options` are those of `ParallelArmsEnv`. Raises StageError where PettingZoo is not installed.
    """
    try:
        from rf_exp.envs.parallel import ParallelArmsEnv  # not above: PettingZoo is optional
    except ModuleNotFoundError as error:
        if error.name != "pettingzoo":
            raise
        raise StageError("PettingZoo is not installed; run: pip install 'rf_exp[envs]'") from error
    return ParallelArmsEnv(task, observations, **options)
