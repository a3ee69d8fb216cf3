"""The example adapter for models of XPolicyLab: its names, its order of arms, its chunks."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from examples.foreign.xpolicylab import Adapter
from rf_exp.client import Contract, validate_chunk


class Model:
    """Model by XPolicyLab's template that moves the arms from their observed joints by 0.1 rad per step."""

    def __init__(self) -> None:
        self.observed: list[dict[str, Any]] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def update_obs(self, obs: dict[str, Any]) -> None:
        self.observed.append(obs)

    def get_action(self) -> list[dict[str, NDArray[Any]]]:
        state = self.observed[-1]["state"]
        joints = [key for key in state if key.endswith("arm_joint_state")]
        return [{**state, **{key: state[key] + 0.1 * step for key in joints}} for step in range(3)]


def test_two_arms_are_left_and_right() -> None:
    model, observation = Model(), Contract(2, width=8, height=6).synthetic_observation()
    policy = Adapter(model, arms=2)
    policy.reset(7)
    chunk = validate_chunk(policy.infer(observation)["actions"], 2)
    assert chunk.shape == (3, 2, 8) and model.resets == 1
    np.testing.assert_allclose(chunk[:, :, :7], observation["qpos"][:, :7] + np.arange(3)[:, None, None] / 10)
    np.testing.assert_allclose(chunk[..., 7], 1)  # as open as observed
    (received,) = model.observed
    np.testing.assert_array_equal(received["state"]["right_arm_joint_state"], observation["qpos"][1, :7])
    seen = {name: each["color"] for name, each in received["vision"].items()}
    assert seen.keys() == {"cam_head", "cam_left_wrist", "cam_right_wrist"}
    np.testing.assert_array_equal(seen["cam_left_wrist"], observation["rgb_agent1"])
    assert received["instruction"] == observation["language"]


def test_one_arm_has_no_side_and_three_have_no_names() -> None:
    model, observation = Model(), Contract(1, cameras="local", width=8, height=6).synthetic_observation()
    observation["qpos"][0, 7:] = 0  # closed
    chunk = validate_chunk(Adapter(model, arms=1).infer(observation)["actions"], 1)
    assert chunk.shape == (3, 1, 8) and (chunk[..., 7] == -1).all()
    (received,) = model.observed
    assert received["state"].keys() == {"arm_joint_state", "ee_joint_state"}
    assert received["vision"].keys() == {"cam_wrist"}
    with pytest.raises(ValueError, match="for one arm and for two; got 3"):
        Adapter(model, arms=3)
