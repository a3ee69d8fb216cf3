"""The xArm7 and the UR5 with the Panda's gripper: their URDFs and closed forms."""

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
JOINTS = (  # of the UR5's URDF: name, position in m, pitch in rad, axis
    ("shoulder_pan", "0 0 0.089159", 0.0, "0 0 1"),
    ("shoulder_lift", "0 0.13585 0", np.pi / 2, "0 1 0"),
    ("elbow", "0 -0.1197 0.425", 0.0, "0 1 0"),
    ("wrist_1", "0 0 0.39225", np.pi / 2, "0 1 0"),
    ("wrist_2", "0 0.093 0", 0.0, "0 0 1"),
    ("wrist_3", "0 0 0.09465", 0.0, "0 1 0"),
)


def bare_ur5(folder: Path) -> Robot:
    """The UR5 without shapes; the URDF of its manufacturer is in an extra."""
    parts, parent = ['<link name="base_link"/>'], "base_link"
    for name, position, pitch, axis in JOINTS:
        limit_rad = 3.14159265359 if name == "elbow" else 6.28318530718
        parts.append(
            f'<link name="{name}_link"/><joint name="{name}_joint" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin rpy="0 {pitch} 0" xyz="{position}"/><axis xyz="{axis}"/>'
            f'<limit lower="-{limit_rad}" upper="{limit_rad}" effort="1" velocity="1"/></joint>'
        )
        parent = f"{name}_link"
    parts.append(
        f'<link name="tool0"/><joint name="fixed" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
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


def sample_joints(robot: Robot, count: int) -> np.ndarray:
    low, high = np.clip(robot.limits_rad, -np.pi, np.pi)
    low = np.where(np.arange(robot.dof) == 5, np.maximum(low, -np.pi / 2), low) if robot.is_redundant else low
    return np.random.default_rng(3).uniform(low, high, (count, robot.dof))


def wrapped(angles: np.ndarray) -> np.ndarray:
    """The angles, wrapped to -pi to pi."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))


def test_every_posture_is_recovered_and_all_branches_reach_the_pose(robot: Robot) -> None:
    joints = sample_joints(robot, 3000)
    poses, limits = robot.tcp_pose(joints), robot.limits_rad
    solutions = robot.solver.postures(poses, joints[:, -1], limits)
    error = np.nan_to_num(np.abs(wrapped(solutions - joints[:, None])).max(axis=-1), nan=np.inf)
    assert error.min(axis=1).max() < 1e-7
    is_valid = np.isfinite(solutions).all(axis=-1)
    np.testing.assert_array_equal(is_valid, np.isfinite(solutions).any(axis=-1))
    assert is_valid.any(axis=0).all() and is_valid.shape == (3000, 8)
    index, _ = np.nonzero(is_valid)
    np.testing.assert_allclose(robot.tcp_pose(solutions[is_valid]), poses[index], atol=1e-9)
    assert ((solutions[is_valid] >= limits[0]) & (solutions[is_valid] <= limits[1])).all()


def test_all_eight_branches_of_the_ur5_are_found_at_rest(ur5: Robot) -> None:
    pose = ur5.tcp_pose(np.array(ur5.rest_rad))
    solutions = ur5.solver.postures(pose, 0.0, ur5.limits_rad)
    assert np.isfinite(solutions).all()
    differences = np.abs(wrapped(solutions[:, None] - solutions)).max(axis=-1)
    assert differences[~np.eye(8, dtype=bool)].min() > 0.1
    np.testing.assert_allclose(solutions[2], ur5.rest_rad, atol=1e-3)  # without an added full turn


@pytest.mark.parametrize("fifth_rad", [0.0, 1e-10, 1e-8, np.pi])
def test_at_the_wrist_singularity_the_sixth_joint_is_the_given_one(ur5: Robot, fifth_rad: float) -> None:
    joints = sample_joints(ur5, 300)
    joints[:, 4] = fifth_rad
    solutions = ur5.solver.postures(ur5.tcp_pose(joints), joints[:, 5], ur5.limits_rad)
    is_valid = np.isfinite(solutions).all(axis=-1)
    index, _ = np.nonzero(is_valid)
    np.testing.assert_allclose(ur5.tcp_pose(solutions[is_valid]), ur5.tcp_pose(joints)[index], atol=1e-9)
    if fifth_rad != 1e-8:
        error = np.nan_to_num(np.abs(wrapped(solutions - joints[:, None])).max(axis=-1), nan=np.inf)
        assert error.min(axis=1).max() < 1e-6


def test_poses_and_last_joints_are_broadcast(robot: Robot) -> None:
    poses, last_rad = robot.tcp_pose(sample_joints(robot, 4)), np.linspace(-2, 2, 5)
    solutions = robot.solver.postures(poses[:, None], last_rad, robot.limits_rad)
    assert solutions.shape == (4, 5, 8, robot.dof)
    assert robot.solver.preferred_last_rad(poses).shape == (4,)


def test_grippers_point_down_at_rest_and_out_of_reach_there_is_no_posture(robot: Robot) -> None:
    arm = Arm(robot, np.eye(4))
    for posture in (robot.rest_rad, robot.aside_rad):
        tcp = arm.tcp(np.array(posture))
        np.testing.assert_allclose(tcp[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-3)
        assert abs(tcp[1, 3]) < 1e-3 and 0.15 < tcp[2, 3] < 0.35
    far = planar(2.0, 0.0, 0.0, 0.3)
    assert np.isnan(arm.postures(far, arm.preferred_last_rad(far))).all()


# -- URDFs ---------------------------------------------------------------------------------------------


def test_the_urdf_combines_the_arm_with_the_panda_gripper(robot: Robot) -> None:
    gripper_links = [name for name in DEFAULT.links if name in DEFAULT.gripper]
    assert set(gripper_links) <= set(robot.links) and robot.gripper == DEFAULT.gripper
    for name in gripper_links:
        np.testing.assert_array_equal(robot.hulls[name].bounds, DEFAULT.hulls[name].bounds)
    link_poses = robot.link_poses(np.append(np.array(robot.rest_rad), [0.04, 0.04]))
    left, right = (link_poses[robot.links.index(f"panda_{side}finger")][:3, 3] for side in ("left", "right"))
    assert np.linalg.norm(left - right) == pytest.approx(0.08)


def test_the_xarm7_has_the_links_and_sizes_of_its_manufacturer() -> None:
    assert XARM7.links[0] == "link_base" and len(XARM7.links) == 11
    low, high = XARM7.hulls["link_base"].bounds
    assert (high - low < 0.25).all()
    pairs = {(XARM7.links[i], XARM7.links[j]) for i, j in XARM7.self_pairs}
    assert ("link_base", "panda_hand") in pairs and ("link7", "panda_hand") not in pairs


def test_the_identity_of_a_robot_is_independent_of_the_cache_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = XARM7.identity["urdf"]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(mounted, "_combined_urdf", mounted._combined_urdf.__wrapped__)
    assert XARM7.urdf_path.is_relative_to(tmp_path)
    assert XARM7.identity["urdf"] == before


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_parts_that_do_not_match_are_refused(changed: dict[str, str], message: str) -> None:
    assert isinstance(XARM7.urdf, Mounted)
    with pytest.raises(ArgumentError, match=message):
        _ = replace(XARM7.urdf, **changed).path


def test_the_ur5_of_the_extra_has_the_same_kinematics(ur5: Robot) -> None:
    try:
        distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install 'rf_exp[ur5]'")
    joints = sample_joints(UR5, 50)
    np.testing.assert_allclose(UR5.tcp_pose(joints), ur5.tcp_pose(joints), atol=1e-9)
    assert UR5.links[0] == "base_link" and len(UR5.links) == 10
    colours = UR5.meshes["shoulder_link"][2]
    assert len(np.unique(colours, axis=0)) == 3  # grey, black, and the blue caps


def test_meshes_without_a_colour_are_white() -> None:
    """The default of glTF: some shells of the xArm7 have no colour."""
    _, _, colours = XARM7.meshes["link1"]
    assert colours.max() == 1.0
