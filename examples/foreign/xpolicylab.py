"""Foreign policy from a `Model` of XPolicyLab, for one arm or two: docs/serving.md.

    from rf_exp_client import serve
    serve(Adapter(Model(config), arms=2), host="0.0.0.0")

XPolicyLab's left arm is agent 1 and its right arm agent 2; it has no names for a third. This file needs only
NumPy.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

SIDES = {1: ("",), 2: ("left_", "right_")}  # number of arms -> prefixes of their keys
OPEN_M, JOINTS, CONTROL_HZ = 0.04, 7, 20  # opening of a finger of the Panda's gripper; joints of an arm


class Adapter:
    """Adapter: passes observations to a model under XPolicyLab's names, and returns its chunks.

    The model's gripper has the scale of our commands, -1 (closed) to 1 (open), in states and actions. Raises
    ValueError for more than two arms.
    """

    def __init__(self, model: Any, arms: int) -> None:
        if arms not in SIDES:
            raise ValueError(f"XPolicyLab has names for one arm and for two; got {arms}")
        self._model, self._sides = model, SIDES[arms]

    def reset(self, seed: int) -> None:
        """Resets the model, which takes no seed."""
        self._model.reset()

    def infer(self, observation: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
        """Actions (T, N, 8): joint targets in rad and gripper, per step and arm."""
        self._model.update_obs(self.theirs(observation))
        keys = ("arm_joint_state", "ee_joint_state")
        steps = [
            [np.concatenate([np.ravel(step[side + key]) for key in keys]) for side in self._sides]
            for step in self._model.get_action()
        ]
        return {"actions": np.array(steps, float)}

    def theirs(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Our observation in XPolicyLab's format v1.0; pictures are RGB in both."""
        state: dict[str, NDArray[Any]] = {}
        cameras = {"cam_head": "global"}
        for agent, (side, qpos) in enumerate(zip(self._sides, observation["qpos"], strict=True), start=1):
            state[f"{side}arm_joint_state"] = qpos[:JOINTS]
            state[f"{side}ee_joint_state"] = qpos[JOINTS:].mean(keepdims=True) / OPEN_M * 2 - 1
            cameras[f"cam_{side}wrist"] = f"agent{agent}"
        pictures = {name: observation.get(f"rgb_{ours}") for name, ours in cameras.items()}
        vision = {name: {"color": picture} for name, picture in pictures.items() if picture is not None}
        return {
            "data_format_version": "v1.0",
            "instruction": observation.get("language", ""),
            "additional_info": {"frequency": CONTROL_HZ},
            "vision": vision,
            "state": state,
        }
