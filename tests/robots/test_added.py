"""Added robots: from a URDF to kinematics, plans, simulation and stores, beside the default robot."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from omegaconf import OmegaConf

from rf_exp.datagen import EpisodeGenerator, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs.central import CentralEnv
from rf_exp.errors import ArgumentError
from rf_exp.geometry import PlanningScene
from rf_exp.robots import DEFAULT, Arm, Finger, Hand, Robot, add_robot, registry, robot_named
from rf_exp.robots.kinematics import Numeric
from rf_exp.sim import Simulator
from rf_exp.store import Store, command_names, joint_names
from rf_exp.tasks import CONFIGURED, Task, load_task, read_task
from rf_exp.transforms import planar
from rf_exp.types import FINGERS, ConstraintSet, arm_of, fingers_of, gripper_of, joints_of
from tests.robots.toy import toy

NO_GRIPPER = Hand(
    "link_eef", "link_eef", (Finger("link7", (), (0, 1, 0)), Finger("link7", (), (0, -1, 0))), 0.04, 0
)
XARM = Robot(
    name="xarm7",
    title="xArm7 without a hand",
    urdf="package://mani_skill/assets/robots/xarm7/xarm7.urdf",
    joints=tuple(f"joint{k}" for k in range(1, 8)),
    hand=NO_GRIPPER,
    rest_rad=(0.0, -0.4, 0.0, 0.5, 0.0, 0.9, 0.0),
    aside_rad=(0.0, -1.0, 0.0, 1.2, 0.0, 1.5, 0.0),
    reach_m=0.7,
)


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return toy(tmp_path_factory.mktemp("robots"))


@pytest.fixture(autouse=True)
def only_the_default_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_ROBOTS", {DEFAULT.name: DEFAULT})


@pytest.fixture(params=["six", "xarm7"])
def robot(request: pytest.FixtureRequest, six: Robot) -> Robot:
    return {"six": six, "xarm7": XARM}[request.param]


def node(name: str) -> dict[str, Any]:
    content: Any = OmegaConf.to_container(OmegaConf.load(CONFIGURED / f"{name}.yaml"))
    return content[name]


@pytest.fixture
def mixed(six: Robot) -> Task:
    """A task with the default arm and one of six joints."""
    add_robot(six)
    content = node("two_robots_stack_cube")
    content["robots"][1]["model"] = six.name
    return load_task("two_robots_stack_cube", content)


# -- kinematics ----------------------------------------------------------------------------------------


def test_poses_of_links_and_tcp_equal_those_of_pinocchio(robot: Robot) -> None:
    model = pin.buildModelFromUrdf(str(robot.urdf_path))
    data, rng = model.createData(), np.random.default_rng(0)
    low, high = np.clip(robot.limits_rad, -np.pi, np.pi)
    joints = rng.uniform(low, high, (20, robot.dof))
    fingers = rng.uniform(0, 0.04, (20, FINGERS))
    links, tcps = robot.link_poses(np.hstack([joints, fingers])), robot.tcp_pose(joints)
    for i in range(20):
        values = {name: value for name, value in zip(robot.joints, joints[i], strict=True)}
        for finger, value in zip(robot.hand.fingers, fingers[i], strict=True):
            values |= dict.fromkeys(finger.joints, value)
        pin.framesForwardKinematics(model, data, np.array([values[name] for name in list(model.names)[1:]]))
        for name, pose in (*zip(robot.links, links[i], strict=True), (robot.hand.tcp, tcps[i])):
            expected = data.oMf[model.getFrameId(name)].homogeneous
            np.testing.assert_allclose(pose, expected, atol=1e-12, err_msg=name)


def test_padding_for_arms_with_more_joints_is_ignored(six: Robot) -> None:
    qpos = np.append(np.random.default_rng(1).uniform(-1, 1, 6), [0.01, 0.02])
    padded = np.concatenate([qpos[:6], [0.7], qpos[6:]])
    np.testing.assert_array_equal(six.link_poses(padded), six.link_poses(qpos))
    np.testing.assert_array_equal(six.tcp_pose(padded), six.tcp_pose(qpos))


def test_every_posture_reaches_the_pose_within_the_limits(robot: Robot) -> None:
    low, high = np.clip(robot.limits_rad, -np.pi, np.pi) * 0.95
    joints = np.random.default_rng(2).uniform(low, high, (300, robot.dof))
    poses = robot.tcp_pose(joints)
    postures = Arm(robot, np.eye(4)).postures(poses, joints[:, -1])
    is_valid = np.isfinite(postures).all(axis=-1)
    assert postures.shape == (300, robot.solver.branches, robot.dof)
    assert is_valid.any(axis=-1).mean() > 0.9
    index, _ = np.nonzero(is_valid)
    np.testing.assert_allclose(robot.tcp_pose(postures[is_valid]), poses[index], atol=1e-7)
    assert ((postures[is_valid] >= robot.limits_rad[0]) & (postures[is_valid] <= robot.limits_rad[1])).all()
    if robot.is_redundant:
        # The last joint is the given one.
        np.testing.assert_allclose(np.cos(postures[is_valid][:, -1]), np.cos(joints[index, -1]), atol=1e-12)


def test_postures_near_rest_are_recovered(robot: Robot) -> None:
    arm, rng = Arm(robot, planar(0.3, -0.7, 1.2, 0.1)), np.random.default_rng(3)
    for _ in range(20):
        joints = np.array(robot.rest_rad) + rng.uniform(-0.3, 0.3, robot.dof)
        solution = arm.solve(
            arm.tcp(joints), joints + rng.uniform(-0.05, 0.05, robot.dof) * (np.arange(robot.dof) < 6)
        )
        assert solution is not None
        np.testing.assert_allclose(solution, joints, atol=1e-6)


def test_out_of_reach_there_is_no_posture(robot: Robot) -> None:
    arm, far = Arm(robot, np.eye(4)), planar(2.0, 0.0, 0.0, 0.3)
    assert np.isnan(arm.postures(far, arm.preferred_last_rad(far))).all()
    assert arm.solve(far, np.array(robot.rest_rad)) is None


def test_numeric_postures_equal_those_of_the_closed_form() -> None:
    low, high = DEFAULT.limits_rad * 0.9
    joints = np.random.default_rng(4).uniform(low, high, (100, 7))
    poses, limits = DEFAULT.tcp_pose(joints), DEFAULT.limits_rad
    numeric = Numeric(DEFAULT).postures(poses, joints[:, -1], limits)
    exact = DEFAULT.solver.postures(poses, joints[:, -1], limits)
    is_valid = np.isfinite(numeric).all(axis=-1)
    error = np.abs(numeric[:, :, None] - exact[:, None]).max(axis=-1)
    assert is_valid.any(axis=-1).mean() > 0.8
    assert np.nanmin(error, axis=2, initial=np.inf)[is_valid].max() < 1e-5


# -- shapes and sizes ----------------------------------------------------------------------------------


def test_hulls_limits_and_pairs_match_the_urdf(six: Robot) -> None:
    assert six.links == ("base", *(f"link{k}" for k in range(1, 7)), "left", "right")
    assert six.gripper == {"link6", "left", "right"}
    np.testing.assert_allclose(six.hulls["link2"].extents, (0.07, 0.07, 0.36))
    np.testing.assert_allclose(six.hulls["base"].bounds[:, 2], (0.0, 0.1))
    np.testing.assert_array_equal(six.limits_rad[1], (2.9, 1.9, 2.7, 2.9, 2.6, 2.9))
    pairs = {(six.links[i], six.links[j]) for i, j in six.self_pairs}
    assert ("base", "link5") in pairs and ("link2", "left") in pairs
    assert not pairs & {("base", "link1"), ("link6", "left"), ("left", "right")}


def test_its_visual_meshes_are_loaded(six: Robot) -> None:
    assert set(six.meshes) == set(six.links)
    vertices, faces, colours = six.meshes["link2"]
    np.testing.assert_allclose(np.ptp(vertices, axis=0), (0.07, 0.07, 0.36))
    assert faces.max() < len(vertices) == len(colours)


def test_rows_have_the_size_of_the_largest_arm(six: Robot, mixed: Task) -> None:
    add_robot(six)
    alone = load_task(
        "stack_cube",
        {**node("stack_cube"), "robots": [{"x_m": -0.6, "y_m": 0, "yaw_deg": 0, "model": "toy"}]},
    )
    assert (alone.dof, mixed.dof) == (6, 7)
    assert alone.start(0).qpos.shape == (1, 8) and mixed.start(0).qpos.shape == (2, 9)
    qpos = mixed.start(0).qpos
    assert joints_of(qpos)[1, 6] == 0 and (joints_of(qpos)[1, :6] != 0).all()
    np.testing.assert_array_equal(fingers_of(qpos), 0.04)
    env = CentralEnv(mixed)
    try:
        assert env.action_space.shape == (2, 8)
        assert env.action_space.low[1, 6] == env.action_space.high[1, 6] == 0
        np.testing.assert_allclose(env.action_space.high[1, :6], six.limits_rad[1], rtol=1e-6)
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
    finally:
        env.close()


def test_the_planning_scene_has_the_links_of_each_robot(mixed: Task, six: Robot) -> None:
    scene = PlanningScene(mixed, mixed.start(0).scene)
    first, second = scene.measured(1), scene.measured(2)
    assert first.labels == DEFAULT.links and second.labels == six.links
    assert (first.gripper, second.base) == (DEFAULT.gripper, "base")
    arm = mixed.arms[2]
    np.testing.assert_allclose(second.poses[0], arm.links(mixed.start(0).qpos[1]), atol=1e-12)
    np.testing.assert_array_equal(scene.arm(2, np.array(six.rest_rad)).poses[0, -1, :3, 3].shape, (3,))
    assert scene.between(1, 2).distance_m > 0.3


# -- from a task to a store ----------------------------------------------------------------------------


@pytest.mark.slow
def test_an_episode_of_two_kinds_of_arms_is_generated_and_stored(
    mixed: Task, six: Robot, tmp_path: Path
) -> None:
    settings = Settings.configured(mixed, ConstraintSet("full"), ScriptedSpec())
    with Simulator(mixed, render=False) as world:
        outcome = EpisodeGenerator(settings, world, settings.make_brain(0)).make(0)
    assert outcome.success and outcome.episode is not None, outcome.reason
    episode = outcome.episode
    assert episode.qpos.shape[1:] == (2, 9) and episode.action.shape[1:] == (2, 8)
    assert not arm_of(episode.action)[:, 1, 6].any() and not joints_of(episode.qpos)[:, 1, 6].any()
    assert set(np.unique(gripper_of(episode.action))) == {-1.0, 1.0}
    robots, size = [robot.model for robot in mixed.robots], (2, (), 0, 0, tuple(mixed.objects))
    with Store.create(tmp_path / "mixed.zarr", {"task": mixed.name}, *size, robots=robots) as store:
        store.append(episode)
    stored = Store.open(tmp_path / "mixed.zarr")
    np.testing.assert_array_equal(stored.qpos, episode.qpos)
    assert [model.title for model in stored.models] == [DEFAULT.title, six.title]
    assert command_names(stored.attrs, 2) == (*six.joints, "unused7", "gripper")
    assert joint_names(stored.attrs, 1) == DEFAULT.qpos_names
    assert joint_names(stored.attrs)[-3:] == ("joint7", "finger1", "finger2")


def test_a_store_of_one_kind_of_robot_has_its_sizes(six: Robot, tmp_path: Path) -> None:
    with Store.create(tmp_path / "s.zarr", {"task": "t"}, 1, (), 0, 0, robots=[six]) as store:
        assert store.qpos.shape == (0, 1, 8) and store.action.shape == (0, 1, 7)
        assert command_names(store.attrs) == six.command_names
    with Store.create(tmp_path / "usual.zarr", {"task": "t"}, 1, (), 0, 0, robots=[DEFAULT]) as store:
        assert "robots" not in store.attrs  # as in older stores


# -- errors --------------------------------------------------------------------------------------------


def test_an_unknown_model_is_refused_with_the_known_ones(six: Robot) -> None:
    content = node("stack_cube")
    content["robots"][0]["model"] = "toy"
    with pytest.raises(ArgumentError, match=r"task 'stack_cube': .*robot model 'toy'.*panda"):
        load_task("stack_cube", content)
    add_robot(six)
    assert load_task("stack_cube", content).robots[0].model is six
    assert robot_named("toy") is six


def test_the_code_of_a_task_may_add_its_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stack_with_a_toy.py").write_text(
        "from pathlib import Path\n"
        "from rf_exp.robots import add_robot\n"
        "from rf_exp.tasks.stack_cube import *\n"
        "from tests.robots.toy import toy\n"
        "add_robot(toy(Path(__file__).parent, 'small_arm'))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    content = {**node("stack_cube"), "name": "small", "code": "stack_with_a_toy"}
    content["robots"][0]["model"] = "small_arm"
    OmegaConf.save({"small": content}, tmp_path / "small.yaml")
    task = read_task(tmp_path / "small.yaml")
    assert task.robots[0].model.dof == task.dof == 6
    assert task.robots[0].rest_rad == task.robots[0].model.rest_rad
    assert task.identity["robots"][0]["model"]["name"] == "small_arm"
    assert "model" not in read_task(CONFIGURED / "stack_cube.yaml").identity["robots"][0]


def test_two_robots_with_one_name_are_refused(six: Robot) -> None:
    add_robot(six)
    add_robot(replace(six))  # an equal robot is accepted
    with pytest.raises(ArgumentError, match="there is another robot called 'toy'"):
        add_robot(replace(six, reach_m=0.5))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"joints": ("turn1", "turn2")}, "robot 'toy' has 2 joints; expected an arm with 6 or 7"),
        ({"rest_rad": (0.0,) * 5}, "rest_rad has 5 values; the arm has 6 joints"),
        ({"aside_rad": (0.0,) * 7}, "aside_rad has 7 values; the arm has 6 joints"),
    ],
)
def test_an_inconsistent_robot_is_refused(six: Robot, changed: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        replace(six, **changed)


def test_a_robot_that_does_not_match_its_urdf_is_refused(six: Robot) -> None:
    joints = ("turn2", "turn1", *six.joints[2:])
    with pytest.raises(ArgumentError, match=r"has the joints turn1, turn2, .* expected revolute ones: turn2"):
        _ = replace(six, name="a", joints=joints).limits_rad
    with pytest.raises(ArgumentError, match="link of robot 'b' 'nose'"):
        _ = replace(six, name="b", hand=replace(six.hand, tcp="nose")).limits_rad
    left = replace(six.hand.fingers[0], joints=("thumb",))
    with pytest.raises(ArgumentError, match="joint of the hand of robot 'c' 'thumb'"):
        _ = replace(six, name="c", hand=replace(six.hand, fingers=(left, left))).limits_rad


def test_a_rest_posture_for_another_arm_is_refused(six: Robot) -> None:
    add_robot(six)
    content = node("stack_cube")
    content["robots"][0] |= {"model": "toy", "rest_rad": [0.0] * 7}
    with pytest.raises(ArgumentError, match="rest_rad has 7 values; an arm has 6 joints"):
        load_task("stack_cube", content)


def test_a_robot_can_be_pickled(six: Robot) -> None:
    copy = pickle.loads(pickle.dumps(six))
    assert copy == six and hash(copy) == hash(six) and copy is not six
