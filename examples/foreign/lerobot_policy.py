"""Foreign policy from a LeRobot checkpoint: ACT, or another policy that predicts from one observation.

    PYTHONPATH=. python examples/foreign/serve.py examples.foreign.lerobot_policy:make \
        --options '{"checkpoint": "outputs/act/checkpoints/last/pretrained_model"}'

Runs in a Python environment of lerobot, which needs other packages than the suite. docs/foreign.md describes
training on an export of ours.
"""

# pyright: reportMissingImports=false
from typing import Any

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from numpy.typing import NDArray

CAMERA = "observation.images."


class LeRobotPolicy:
    """Adapter: passes observations to LeRobot under the names of our export, and returns its chunks.

    Raises ValueError for a policy that takes more than one observation.
    """

    def __init__(self, checkpoint: str, steps: int | None) -> None:
        config = PreTrainedConfig.from_pretrained(checkpoint)
        if config.n_obs_steps != 1:
            raise ValueError(
                f"{config.type} looks at {config.n_obs_steps} observations; a chunk begins with one"
            )
        self._policy = get_policy_class(config.type).from_pretrained(checkpoint, config=config)
        self._before, self._after = make_pre_post_processors(config, pretrained_path=checkpoint)
        self._cameras = [name.removeprefix(CAMERA) for name in config.image_features]
        self._steps = steps or config.n_action_steps

    def reset(self, seed: int) -> None:
        """Resets the policy and seeds its random numbers with the seed of the scene."""
        torch.manual_seed(seed)
        self._policy.reset()

    def act(self, observation: dict[str, Any]) -> NDArray[np.float32]:
        """A chunk (T, N * 8) float32: joint targets in rad and gripper, agent by agent."""
        inputs: dict[str, Any] = {"observation.state": torch.from_numpy(observation["qpos"].flatten())}
        for camera in self._cameras:
            picture = np.moveaxis(observation[f"rgb_{camera}"], -1, 0)  # (3, H, W)
            inputs[CAMERA + camera] = torch.from_numpy(picture.astype(np.float32) / 255)
        if "language" in observation:
            inputs["task"] = observation["language"]
        chunk = self._after(self._policy.predict_action_chunk(self._before(inputs)))
        return chunk[0, : self._steps].numpy()


def make(checkpoint: str, steps: int | None = None) -> LeRobotPolicy:
    """The policy in the folder of a checkpoint, with `steps` of each chunk, by default its n_action_steps."""
    return LeRobotPolicy(checkpoint, steps)
