"""The xArm7 and the UR5 with the Panda's hand: their URDFs and closed forms."""

from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.robots import DEFAULT, Arm, Mounted, Robot, mounted, robot_named
from rf_exp.robots.registry import PANDA_URDF
from rf_exp.transforms import planar

XARM7, UR5 = robot_named("xarm7"), robot_named("ur5")
JOINTS = (  # of the UR5's URDF: name, place in m, pitch in rad, axis
    ("shoulder_pan", "0 0 0.089159", 0.0, "0 0 1"),
    ("shoulder_lift", "0 0.13585 0", np.pi / 2, "0 1 0"),
    ("elbow", "0 -0.1197 0.425", 0.0, "0 1 0"),
    ("wrist_1", "0 0 0.39225", np.pi / 2, "0 1 0"),
    ("wrist_2", "0 0.093 0", 0.0, "0 0 1"),
    ("wrist_3", "0 0 0.09465", 0.0, "0 1 0"),
)


def bare_ur5(folder: Path) -> Robot:
    """The UR5 without shapes, whose makers' URDF is in an extra."""
    parts, before = ['<link name="base_link"/>'], "base_link"
    for name, place, pitch, axis in JOINTS:
        turn = 3.14159265359 if name == "elbow" else 6.28318530718
        parts.append(
            f'<link name="{name}_link"/><joint name="{name}_joint" type="revolute"><parent link="{before}"/>'
            f'<child link="{name}_link"/><origin rpy="0 {pitch} 0" xyz="{place}"/><axis xyz="{axis}"/>'
            f'<limit lower="-{turn}" upper="{turn}" effort="1" velocity="1"/></joint>'
        )
        before = f"{name}_link"
    parts.append(
        f'<link name="tool0"/><joint name="fixed" type="fixed"><parent link="{before}"/><child link="tool0"/>'
        '<origin rpy="-1.57079632679 0 0" xyz="0 0.0823 0"/></joint>'
    )
    path = folder / "bare.urdf"
    path.write_text(f'<robot name="bare">{"".join(parts)}</robot>')
    assert isinstance(UR5.urdf, Mounted)
    return replace(UR5, name="bare", urdf=replace(UR5.urdf, arm=str(path), without=()))


@pytest.fixture(scope="module")
def ur5(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return bare_ur5(tmp_path_factory.mktemp("ur5"))


@pytest.fixture(params=["xarm7", "ur5"])
def robot(request: pytest.FixtureRequest, ur5: Robot) -> Robot:
    return {"xarm7": XARM7, "ur5": ur5}[request.param]


def drawn(robot: Robot, count: int) -> np.ndarray:
    low, high = np.clip(robot.limits_rad, -np.pi, np.pi)
    low = np.where(np.arange(robot.dof) == 5, np.maximum(low, -np.pi / 2), low) if robot.is_redundant else low
    return np.random.default_rng(3).uniform(low, high, (count, robot.dof))


def turned(angles: np.ndarray) -> np.ndarray:
    """Without whole turns."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))


def test_every_posture_is_found_again_and_all_branches_put_the_tcp_there(robot: Robot) -> None:
    joints = drawn(robot, 3000)
    poses, limits = robot.tcp_pose(joints), robot.limits_rad
    found = robot.solver.postures(poses, joints[:, -1], limits)
    away = np.nan_to_num(np.abs(turned(found - joints[:, None])).max(axis=-1), nan=np.inf)
    assert away.min(axis=1).max() < 1e-7
    there = np.isfinite(found).all(axis=-1)
    np.testing.assert_array_equal(there, np.isfinite(found).any(axis=-1))
    assert there.any(axis=0).all() and there.shape == (3000, 8)
    which, _ = np.nonzero(there)
    np.testing.assert_allclose(robot.tcp_pose(found[there]), poses[which], atol=1e-9)
    assert ((found[there] >= limits[0]) & (found[there] <= limits[1])).all()


def test_of_the_ur5_all_eight_are_found_where_it_is_free_to_move(ur5: Robot) -> None:
    pose = ur5.tcp_pose(np.array(ur5.rest_rad))
    found = ur5.solver.postures(pose, 0.0, ur5.limits_rad)
    assert np.isfinite(found).all()
    apart = np.abs(turned(found[:, None] - found)).max(axis=-1)
    assert apart[~np.eye(8, dtype=bool)].min() > 0.1
    np.testing.assert_allclose(found[2], ur5.rest_rad, atol=1e-3)  # not a whole turn away


@pytest.mark.parametrize("fifth_rad", [0.0, 1e-10, 1e-8, np.pi])
def test_at_the_wrists_singularity_the_sixth_joint_is_as_it_is_given(ur5: Robot, fifth_rad: float) -> None:
    joints = drawn(ur5, 300)
    joints[:, 4] = fifth_rad
    found = ur5.solver.postures(ur5.tcp_pose(joints), joints[:, 5], ur5.limits_rad)
    there = np.isfinite(found).all(axis=-1)
    which, _ = np.nonzero(there)
    np.testing.assert_allclose(ur5.tcp_pose(found[there]), ur5.tcp_pose(joints)[which], atol=1e-9)
    if fifth_rad != 1e-8:
        away = np.nan_to_num(np.abs(turned(found - joints[:, None])).max(axis=-1), nan=np.inf)
        assert away.min(axis=1).max() < 1e-6


def test_poses_and_last_joints_are_broadcast(robot: Robot) -> None:
    poses, turns = robot.tcp_pose(drawn(robot, 4)), np.linspace(-2, 2, 5)
    found = robot.solver.postures(poses[:, None], turns, robot.limits_rad)
    assert found.shape == (4, 5, 8, robot.dof)
    assert robot.solver.preferred_last_rad(poses).shape == (4,)


def test_hands_are_right_where_they_rest_and_out_of_reach_there_is_no_posture(robot: Robot) -> None:
    arm = Arm(robot, np.eye(4))
    for posture in (robot.rest_rad, robot.aside_rad):
        tcp = arm.tcp(np.array(posture))
        np.testing.assert_allclose(tcp[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-3)
        assert abs(tcp[1, 3]) < 1e-3 and 0.15 < tcp[2, 3] < 0.35
    far = planar(2.0, 0.0, 0.0, 0.3)
    assert np.isnan(arm.postures(far, arm.preferred_last_rad(far))).all()


# -- URDFs ---------------------------------------------------------------------------------------------


def test_the_urdf_is_that_of_the_arm_with_the_hand_of_the_other(robot: Robot) -> None:
    hand = [name for name in DEFAULT.links if name in DEFAULT.gripper]
    assert set(hand) <= set(robot.links) and robot.gripper == DEFAULT.gripper
    for name in hand:
        np.testing.assert_array_equal(robot.hulls[name].bounds, DEFAULT.hulls[name].bounds)
    own = robot.link_poses(np.append(np.array(robot.rest_rad), [0.04, 0.04]))
    left, right = (own[robot.links.index(f"panda_{side}finger")][:3, 3] for side in ("left", "right"))
    assert np.linalg.norm(left - right) == pytest.approx(0.08)


def test_the_xarm7_is_of_its_makers_sizes_and_colours() -> None:
    assert XARM7.links[0] == "link_base" and len(XARM7.links) == 11
    low, high = XARM7.hulls["link_base"].bounds
    assert (high - low < 0.25).all()
    named = {(XARM7.links[i], XARM7.links[j]) for i, j in XARM7.self_pairs}
    assert ("link_base", "panda_hand") in named and ("link7", "panda_hand") not in named


def test_the_same_parts_are_the_same_robot_wherever_they_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = XARM7.identity["urdf"]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(mounted, "_combined_urdf", mounted._combined_urdf.__wrapped__)
    assert XARM7.urdf_path.is_relative_to(tmp_path)
    assert XARM7.identity["urdf"] == before


def test_what_is_not_installed_is_named_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = Mounted(
        "distribution://no-such-robots/arm.urdf", "tool0", PANDA_URDF, "panda_hand", extra="ur5"
    )
    with pytest.raises(StageError) as error:
        _ = replace(UR5, name="missing", urdf=missing).links
    assert str(error.value) == "the package no-such-robots is not installed; run: pip install 'rf_exp[ur5]'"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"flange": "nose"}, "has no link 'nose' to mount the hand on"),
        ({"root": "thumb"}, "the URDF of 'panda' has no link 'thumb'"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changed: dict[str, str], message: str) -> None:
    assert isinstance(XARM7.urdf, Mounted)
    with pytest.raises(ArgumentError, match=message):
        _ = replace(XARM7.urdf, **changed).path


def test_the_ur5_of_the_extra_is_the_one_whose_postures_are_known(ur5: Robot) -> None:
    try:
        distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install 'rf_exp[ur5]'")
    joints = drawn(UR5, 50)
    np.testing.assert_allclose(UR5.tcp_pose(joints), ur5.tcp_pose(joints), atol=1e-9)
    assert UR5.links[0] == "base_link" and len(UR5.links) == 10
    colours = UR5.meshes["shoulder_link"][2]
    assert len(np.unique(colours, axis=0)) == 3  # grey, black, and the blue of its caps


def test_meshes_without_a_colour_are_white() -> None:
    """As glTF has it: some of the xArm7's shells name none."""
    _, _, colours = XARM7.meshes["link1"]
    assert colours.max() == 1.0
