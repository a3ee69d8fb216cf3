"""Arms with fewer than seven joints in policies: padded rows and task-space actions."""

from pathlib import Path

import numpy as np
import pytest

from rf_exp.policy import Stream
from rf_exp.policy.inputs.observation_spec import ObservationSpec, tcp_poses
from rf_exp.policy.inputs.rows import GRIPPER, unpadded_commands, with_padding
from rf_exp.policy.inputs.task_space import joint_actions, task_space_actions
from rf_exp.robots import DEFAULT, add_robot, registry
from rf_exp.transforms import planar
from rf_exp.types import FINGERS
from tests.robots.toy import toy


def test_rows_are_padded_before_the_gripper_and_unpadded_again() -> None:
    command, measured = np.arange(14.0).reshape(2, 7), np.arange(16.0).reshape(2, 8)
    assert with_padding(command, GRIPPER)[0].tolist() == [0, 1, 2, 3, 4, 5, 0, 6]
    assert with_padding(measured, FINGERS)[0].tolist() == [0, 1, 2, 3, 4, 5, 0, 6, 7]
    np.testing.assert_array_equal(unpadded_commands(with_padding(command, GRIPPER), 6), command)
    usual = np.zeros((3, 8))
    assert with_padding(usual, GRIPPER) is usual and unpadded_commands(usual, 7) is usual


def test_joints_of_an_arm_with_six_follow_its_gripper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a Panda: joints of both that are a little off are corrected to the predicted gripper poses."""
    monkeypatch.setattr(registry, "_ROBOTS", {DEFAULT.name: DEFAULT})
    arm = toy(tmp_path)
    add_robot(arm)
    spec, bases = ObservationSpec(robots=("panda", "toy")), [planar(0.0, -0.6, 1.5), planar(0.5, 0.6, -1.5)]
    stream, rng = Stream("global", (1, 2)), np.random.default_rng(3)
    usual = DEFAULT.rest_rad + rng.normal(0, 0.1, (4, 7))
    other = np.column_stack([arm.rest_rad + rng.normal(0, 0.1, (4, 6)), np.zeros(4)])
    action = np.concatenate([np.stack([usual, other], axis=1), np.ones((4, 2, 1))], axis=2)
    chunk = task_space_actions(spec, bases, stream, action).astype(float)
    chunk[:, :6] += rng.normal(0, 0.01, 6)
    chunk[:, 8:14] += rng.normal(0, 0.01, 6)
    found = joint_actions(spec, bases, stream, chunk)
    assert not found[:, 1, 6].any()
    intended, reached = (tcp_poses(spec, bases, stream, each[..., :7]) for each in (action, found))
    np.testing.assert_allclose(reached, intended, atol=2e-3)
