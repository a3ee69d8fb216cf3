"""Environment for LeRobot: vectors of all arms, pictures by camera, and whether an episode succeeded.

The keys match those of an export (`python -m rf_exp.data export --format lerobot`). The plug-in by which
`lerobot-eval --env.type=rf_exp` finds it is plugins/lerobot_env_rf_exp; this module does not need LeRobot.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rf_exp.envs.central import CentralEnv
from rf_exp.envs.core import checked_action, find_task
from rf_exp.envs.observations import action_space, observation_space
from rf_exp.errors import ArgumentError
from rf_exp.observations import ObservationDict, Observations
from rf_exp.tasks import Task

LEROBOT_ID = "rf_exp/lerobot-v1"
RGB, POSE, PIXELS = "rgb_", "pose_", "pixels"
# Entries of info that are kept.
INFO_KEYS = ("success", "success_paper", "stopped", "score", "seed", "violations")


class LeRobotEnv(CentralEnv):
    """Environment of a task for one policy of all N arms, with LeRobot's keys.

    Actions (N * A,) float32, agents concatenated: joint targets in rad and the gripper in
    [-1 closed, 1 open], clipped to their limits. Observations, selected by `observations`: `agent_pos`
    (N * D,) float32, measured joints in rad and fingers in m; with state `full` `environment_state` (K * 7,)
    float32, position in m and quaternion (w, x, y, z) of each object in the world; `pixels`, camera ->
    (H, W, 3) uint8, RGB. `info` has `is_success`, by the strict criterion. Options and errors are those of
    `EpisodeCore`; also raises ArgumentError for observations that LeRobot has no key for.
    """

    def __init__(
        self,
        task: str | Path | Task,
        observations: Observations | None = None,
        *,
        render_mode: str | None = "rgb_array",
        **options: Any,
    ) -> None:
        observations = Observations("joints", pictures=True) if observations is None else observations
        observed_space, commanded_space = lerobot_spaces(task, observations)
        super().__init__(task, observations, render_mode=render_mode, **options)
        self._action_shape = self.action_space.shape  # (N, A)
        self.observation_space, self.action_space = observed_space, commanded_space
        # LeRobot reads these attributes.
        self.task_description, self._max_episode_steps = self.task.description, self.task.step_limit

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Resets as `CentralEnv.reset` does; LeRobot's `options` do not concern the scene and are ignored."""
        observation, info = super().reset(seed=seed)
        return _lerobot_observation(observation), _lerobot_info(info)

    def step(self, action: NDArray[np.floating]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """One control step, 50 ms: observation, reward, terminated, truncated, info."""
        command = checked_action(action, self.action_space.shape, "action").reshape(self._action_shape)
        observation, reward, terminated, truncated, info = super().step(command)
        return _lerobot_observation(observation), reward, terminated, truncated, _lerobot_info(info)


def lerobot_spaces(task: str | Path | Task, observations: Observations) -> tuple[spaces.Dict, spaces.Box]:
    """Observation and action space of `LeRobotEnv`, without a simulator. Raises ArgumentError as it does."""
    if observations.depth or observations.segmentation or observations.calibration or observations.language:
        raise ArgumentError(
            "LeRobot has keys for joints, poses and colour, and reads the task's words elsewhere; expected "
            "observations without depth, segmentation, calibration and language"
        )
    resolved_task = find_task(task)
    low, high = (
        _lerobot_observation(_bounds(observation_space(observations, resolved_task), bound))
        for bound in ("low", "high")
    )
    spaces_by_key: dict[str, spaces.Space] = {
        key: spaces.Box(low[key], high[key], dtype=np.float32) for key in low if key != PIXELS
    }
    if PIXELS in low:
        picture_spaces: dict[str, spaces.Space] = {
            name: spaces.Box(0, 255, limits.shape, np.uint8) for name, limits in low[PIXELS].items()
        }
        spaces_by_key[PIXELS] = spaces.Dict(picture_spaces)
    arm_actions = action_space(resolved_task)
    return spaces.Dict(spaces_by_key), spaces.Box(
        arm_actions.low.ravel(), arm_actions.high.ravel(), dtype=np.float32
    )


def _bounds(space: spaces.Dict, bound: str) -> ObservationDict:
    """An observation of the smallest (`low`) or largest (`high`) values of a space."""
    return {key: getattr(part, bound) for key, part in space.items()}


def _lerobot_observation(observation: ObservationDict) -> ObservationDict:
    """An observation of `CentralEnv` with LeRobot's keys."""
    poses = [observation[key] for key in observation if key.startswith(POSE)]
    pictures = {key.removeprefix(RGB): observation[key] for key in observation if key.startswith(RGB)}
    return {
        **({"agent_pos": observation["qpos"].ravel()} if "qpos" in observation else {}),
        **({"environment_state": np.concatenate(poses)} if poses else {}),
        **({PIXELS: pictures} if pictures else {}),
    }


def _lerobot_info(info: dict[str, Any]) -> dict[str, Any]:
    """LeRobot's `is_success`, and the entries that its vectorised environments can hold."""
    return {"is_success": info["success"], **{key: info[key] for key in INFO_KEYS}}


gymnasium.register(LEROBOT_ID, entry_point=LeRobotEnv)
