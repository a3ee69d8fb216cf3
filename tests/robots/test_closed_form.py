"""All postures of the Panda: inverse against forward kinematics, over the full joint ranges."""

import numpy as np
import pytest

from rf_exp.robots import DEFAULT, Arm
from rf_exp.robots.closed_form import BRANCHES, OPPOSITE_BRANCH, postures
from rf_exp.transforms import planar

LOW, HIGH = LIMITS = DEFAULT.limits_rad


def sample_joints(count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(LOW, HIGH, (count, 7))


def test_every_posture_is_recovered():
    joints = sample_joints(3000)
    solutions = postures(DEFAULT.tcp_pose(joints), joints[:, 6], LIMITS)
    error = np.nan_to_num(np.abs(solutions - joints[:, None]).max(axis=-1), nan=np.inf)
    assert error.min(axis=1).max() < 1e-7


def test_every_branch_occurs_and_reaches_the_pose_within_the_limits():
    joints = sample_joints(3000)
    poses = DEFAULT.tcp_pose(joints)
    solutions = postures(poses, joints[:, 6], LIMITS)
    is_valid = np.isfinite(solutions).all(axis=-1)
    np.testing.assert_array_equal(is_valid, np.isfinite(solutions).any(axis=-1))
    assert is_valid.any(axis=0).all() and is_valid.shape == (3000, BRANCHES)
    index, _ = np.nonzero(is_valid)
    np.testing.assert_allclose(DEFAULT.tcp_pose(solutions[is_valid]), poses[index], atol=1e-9)
    assert ((solutions[is_valid] >= LOW) & (solutions[is_valid] <= HIGH)).all()


def test_poses_and_last_joints_are_broadcast():
    joints = sample_joints(4)
    poses, last_rad = DEFAULT.tcp_pose(joints), np.linspace(-2, 2, 5)
    solutions = postures(poses[:, None], last_rad, LIMITS)
    assert solutions.shape == (4, 5, BRANCHES, 7)
    for k, angle_rad in enumerate(last_rad):
        np.testing.assert_array_equal(solutions[:, k], postures(poses, np.full(4, angle_rad), LIMITS))


def test_beyond_reach_there_is_no_posture():
    far = planar(0.9, 0.0, 0.0, 0.6)
    assert np.isnan(postures(far, np.linspace(-2.5, 2.5, 11), LIMITS)).all()
    assert Arm(DEFAULT, np.eye(4)).solve(far, np.zeros(7)) is None


def test_an_arm_that_crosses_its_shoulder_continues_in_the_opposite_branch():
    before = np.array([0.3, 0.05, 0.1, -2.0, 0.0, 2.2, 0.5])
    path = before + np.linspace(0, 1, 40)[:, None] * np.array([0, -0.1, 0, 0, 0, 0, 0])
    solutions = postures(DEFAULT.tcp_pose(path), path[:, 6], LIMITS)
    error = np.nan_to_num(np.abs(solutions - path[:, None]).max(axis=-1), nan=np.inf)
    first, last = error.argmin(axis=1)[[0, -1]]
    assert error.min(axis=1).max() < 1e-7 and last == OPPOSITE_BRANCH[first]


def test_the_arm_is_upright_when_facing_a_tilted_tool():
    """Also if the upper arm is nearly vertical, where all nearby postures have the elbow aside."""
    arm, rng = Arm(DEFAULT, planar(0.2, -0.7, 1.2)), np.random.default_rng(0)
    for _ in range(50):
        low, high = (-1.5, -0.1, 0, -2.4, -0.15, -0.2, -1.0), (1.5, 0.8, 0, -1.4, 0.15, 0.2, 1.5)
        joints = rng.uniform(low, high)
        joints[5] += joints[1] - joints[3]  # makes the tool point straight down, up to the sampled tilt
        solutions = arm.postures(arm.tcp(joints), arm.preferred_last_rad(arm.tcp(joints)))
        assert np.nanmin(np.abs(solutions - joints).max(axis=1)) < 1e-5


def test_out_of_reach_the_last_joint_is_that_of_a_downward_tool():
    arm = Arm(DEFAULT, planar(0.0, 0.0, 0.0))
    tcp = planar(2.0, 0.0, 0.0, 0.15) @ np.diag([1.0, -1.0, -1.0, 1.0])
    assert arm.preferred_last_rad(tcp) == pytest.approx(np.pi / 4)


def test_the_arm_is_upright_when_facing_a_pose():
    arm = Arm(DEFAULT, planar(0.2, -0.7, 1.2))
    for yaw in (0.6, 1.2, 1.9):
        tcp = planar(0.45, -0.2, yaw, 0.15) @ np.diag([1.0, -1.0, -1.0, 1.0])
        solutions = arm.postures(tcp, arm.preferred_last_rad(tcp))
        swivel = np.abs(solutions[:, [2, 4]]).max(axis=1)
        assert np.nanmin(swivel) < 1e-6
