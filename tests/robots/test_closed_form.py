"""All postures of the Panda: inverse against forward kinematics, over the whole of its joints."""

import numpy as np
import pytest

from rf_exp.robots import DEFAULT, Arm
from rf_exp.robots.closed_form import BRANCHES, OPPOSITE_BRANCH, postures
from rf_exp.transforms import planar

LOW, HIGH = LIMITS = DEFAULT.limits_rad


def drawn(count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(LOW, HIGH, (count, 7))


def test_every_posture_is_found_again():
    joints = drawn(3000)
    found = postures(DEFAULT.tcp_pose(joints), joints[:, 6], LIMITS)
    away = np.nan_to_num(np.abs(found - joints[:, None]).max(axis=-1), nan=np.inf)
    assert away.min(axis=1).max() < 1e-7


def test_every_branch_puts_the_tcp_there_within_the_limits_and_occurs():
    joints = drawn(3000)
    poses = DEFAULT.tcp_pose(joints)
    found = postures(poses, joints[:, 6], LIMITS)
    there = np.isfinite(found).all(axis=-1)
    np.testing.assert_array_equal(there, np.isfinite(found).any(axis=-1))
    assert there.any(axis=0).all() and there.shape == (3000, BRANCHES)
    which, _ = np.nonzero(there)
    np.testing.assert_allclose(DEFAULT.tcp_pose(found[there]), poses[which], atol=1e-9)
    assert ((found[there] >= LOW) & (found[there] <= HIGH)).all()


def test_poses_and_last_joints_are_broadcast():
    joints = drawn(4)
    poses, turns = DEFAULT.tcp_pose(joints), np.linspace(-2, 2, 5)
    found = postures(poses[:, None], turns, LIMITS)
    assert found.shape == (4, 5, BRANCHES, 7)
    for k, turn in enumerate(turns):
        np.testing.assert_array_equal(found[:, k], postures(poses, np.full(4, turn), LIMITS))


def test_beyond_reach_there_is_none():
    far = planar(0.9, 0.0, 0.0, 0.6)
    assert np.isnan(postures(far, np.linspace(-2.5, 2.5, 11), LIMITS)).all()
    assert Arm(DEFAULT, np.eye(4)).solve(far, np.zeros(7)) is None


def test_an_arm_that_crosses_over_its_shoulder_goes_on_in_the_branch_of_the_other_sign():
    before = np.array([0.3, 0.05, 0.1, -2.0, 0.0, 2.2, 0.5])
    path = before + np.linspace(0, 1, 40)[:, None] * np.array([0, -0.1, 0, 0, 0, 0, 0])
    found = postures(DEFAULT.tcp_pose(path), path[:, 6], LIMITS)
    away = np.nan_to_num(np.abs(found - path[:, None]).max(axis=-1), nan=np.inf)
    first, last = away.argmin(axis=1)[[0, -1]]
    assert away.min(axis=1).max() < 1e-7 and last == OPPOSITE_BRANCH[first]


def test_facing_a_pose_of_a_tilted_tool_the_arm_is_upright():
    """Also where the upper arm stands almost straight up, and all postures nearby have the elbow aside."""
    arm, rng = Arm(DEFAULT, planar(0.2, -0.7, 1.2)), np.random.default_rng(0)
    for _ in range(50):
        low, high = (-1.5, -0.1, 0, -2.4, -0.15, -0.2, -1.0), (1.5, 0.8, 0, -1.4, 0.15, 0.2, 1.5)
        joints = rng.uniform(low, high)
        joints[5] += joints[1] - joints[3]  # with which it would point straight down
        found = arm.postures(arm.tcp(joints), arm.preferred_last_rad(arm.tcp(joints)))
        assert np.nanmin(np.abs(found - joints).max(axis=1)) < 1e-5


def test_out_of_reach_the_last_joint_is_that_of_a_tool_that_points_down():
    arm = Arm(DEFAULT, planar(0.0, 0.0, 0.0))
    tcp = planar(2.0, 0.0, 0.0, 0.15) @ np.diag([1.0, -1.0, -1.0, 1.0])
    assert arm.preferred_last_rad(tcp) == pytest.approx(np.pi / 4)


def test_facing_a_pose_the_arm_is_upright():
    arm = Arm(DEFAULT, planar(0.2, -0.7, 1.2))
    for yaw in (0.6, 1.2, 1.9):
        tcp = planar(0.45, -0.2, yaw, 0.15) @ np.diag([1.0, -1.0, -1.0, 1.0])
        found = arm.postures(tcp, arm.preferred_last_rad(tcp))
        swivel = np.abs(found[:, [2, 4]]).max(axis=1)
        assert np.nanmin(swivel) < 1e-6
