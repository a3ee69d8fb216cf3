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
from rf_exp.envs.core import find_task, shaped
from rf_exp.envs.observations import action_space, space
from rf_exp.errors import ArgumentError
from rf_exp.observations import ObservationDict, Observations
from rf_exp.tasks import Task

LEROBOT_ID = "rf_exp/lerobot-v1"
RGB, POSE, PIXELS = "rgb_", "pose_", "pixels"
KEPT = ("success", "success_paper", "stopped", "score", "seed", "violations")  # entries of info that are kept


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
        shown, acts = lerobot_spaces(task, observations)
        super().__init__(task, observations, render_mode=render_mode, **options)
        self._whole = self.action_space.shape  # (N, A)
        self.observation_space, self.action_space = shown, acts
        # LeRobot reads these attributes.
        self.task_description, self._max_episode_steps = self.task.description, self.task.step_limit

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Resets as `CentralEnv.reset` does; LeRobot's `options` do not concern the scene and are ignored."""
        observed, info = super().reset(seed=seed)
        return _keyed(observed), _told(info)

    def step(self, action: NDArray[np.floating]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """One control step, 50 ms: observation, reward, terminated, truncated, info."""
        command = shaped(action, self.action_space.shape, "action").reshape(self._whole)
        observed, reward, terminated, truncated, info = super().step(command)
        return _keyed(observed), reward, terminated, truncated, _told(info)


def lerobot_spaces(task: str | Path | Task, observations: Observations) -> tuple[spaces.Dict, spaces.Box]:
    """Observation and action space of `LeRobotEnv`, without a simulator. Raises ArgumentError as it does."""
    if observations.depth or observations.segmentation or observations.calibration or observations.language:
        raise ArgumentError(
            "LeRobot has keys for joints, poses and colour, and reads the task's words elsewhere; expected "
            "observations without depth, segmentation, calibration and language"
        )
    found = find_task(task)
    low, high = (_keyed(_bounds(space(observations, found), which)) for which in ("low", "high"))
    shown: dict[str, spaces.Space] = {
        key: spaces.Box(low[key], high[key], dtype=np.float32) for key in low if key != PIXELS
    }
    if PIXELS in low:
        boxes: dict[str, spaces.Space] = {
            name: spaces.Box(0, 255, each.shape, np.uint8) for name, each in low[PIXELS].items()
        }
        shown[PIXELS] = spaces.Dict(boxes)
    acts = action_space(found)
    return spaces.Dict(shown), spaces.Box(acts.low.ravel(), acts.high.ravel(), dtype=np.float32)


def _bounds(whole: spaces.Dict, which: str) -> ObservationDict:
    """An observation of the smallest (`low`) or largest (`high`) values of a space."""
    return {key: getattr(each, which) for key, each in whole.items()}


def _keyed(observed: ObservationDict) -> ObservationDict:
    """An observation of `CentralEnv` with LeRobot's keys."""
    poses = [observed[key] for key in observed if key.startswith(POSE)]
    pictures = {key.removeprefix(RGB): observed[key] for key in observed if key.startswith(RGB)}
    return {
        **({"agent_pos": observed["qpos"].ravel()} if "qpos" in observed else {}),
        **({"environment_state": np.concatenate(poses)} if poses else {}),
        **({PIXELS: pictures} if pictures else {}),
    }


def _told(info: dict[str, Any]) -> dict[str, Any]:
    """LeRobot's `is_success`, and the entries that its vectorised environments can hold."""
    return {"is_success": info["success"], **{key: info[key] for key in KEPT}}


gymnasium.register(LEROBOT_ID, entry_point=LeRobotEnv)
