"""Third-party scenes: reading, planning and execution, and refusals with their reasons."""

from collections.abc import Iterator
from typing import Any

import gymnasium
import mani_skill.envs  # noqa: F401  registers the environments
import numpy as np
import pytest

from rf_exp.errors import ArgumentError
from rf_exp.findings import CheckName
from rf_exp.geometry import PlanningScene
from rf_exp.library import (
    Before,
    InteractionPoint,
    KeepOut,
    NoPlan,
    ShareSpace,
    Step,
    Subgoal,
    Workcell,
    transform,
)
from rf_exp.robots import DEFAULT
from rf_exp.transforms import apply, inverse
from tests.library.yard import BASES, BODIES, ThreeArmEnv

pytestmark = pytest.mark.slow

HANDOVER: dict[int, list[str]] = {
    1: ["grasp cube at center", "place cube to middle"],
    2: ["grasp cube at center", "lift cube by 0.1 m"],
}
ORDER = ("Agent_1 must place cube before Agent_2 grasps cube.",)


def make_environment(name: str = "TwoRobotPickCube-v1", **options: Any) -> gymnasium.Env:
    defaults = {"control_mode": "pd_joint_pos", "reward_mode": "none", "max_episode_steps": 600, **options}
    return gymnasium.make(name, obs_mode="none", render_backend="none", **defaults)


@pytest.fixture(scope="module")
def pick_cube() -> Iterator[gymnasium.Env]:
    env = make_environment()
    yield env
    env.close()


@pytest.fixture(scope="module")
def three_arm_env() -> Iterator[ThreeArmEnv]:
    env = ThreeArmEnv()
    yield env
    env.close()


@pytest.fixture
def cell(pick_cube: gymnasium.Env) -> Workcell:
    pick_cube.reset(seed=0)
    return Workcell(pick_cube, places={"middle": transform()})


@pytest.fixture
def three_arm_cell(three_arm_env: ThreeArmEnv) -> Workcell:
    three_arm_env.reset(seed=0)
    return Workcell(three_arm_env, places={"spot": transform((-0.2, 0.15, 0.0))})


# -- reading ---------------------------------------------------------------------------------------


def test_a_scene_is_read_and_described(cell: Workcell) -> None:
    lines = str(cell).splitlines()
    assert lines[0] == "Agent_1: panda_wristcam-0 at (0, -0.75, 0)"
    assert lines[2].startswith("cube at (") and lines[2].endswith(": center (grasp), top (place)")
    assert lines[3].startswith("goal_site at (") and lines[3].endswith(": middle (place)")
    assert lines[4:] == ["middle at (0, 0, 0): a place", "the table: table_workspace, ground"]


def test_a_camera_on_a_gripper_is_checked_for_collisions(cell: Workcell) -> None:
    """The camera of `panda_wristcam` has the pose of its shape in PhysX."""
    body = PlanningScene(cell.task, cell.scene()).arm(1, cell.scene().qpos[0])
    links: list[Any] = cell._environment._joints[0].arm.links
    camera = next(link for link in links if link.name.endswith("camera_link"))
    shape = camera.collision_shapes[0]
    pose = (camera.entity_pose * shape.local_pose).to_transformation_matrix()
    piece, world_from_piece = body.pieces[len(DEFAULT.links)], body.poses[0, len(DEFAULT.links)]
    vertices = apply(inverse(pose), apply(world_from_piece, piece.vertices))
    assert len(body.pieces) == len(DEFAULT.links) + 1
    np.testing.assert_allclose(np.abs(vertices), np.tile(shape.half_size, (8, 1)), atol=1e-5)


def test_poses_and_sizes_of_all_kinds_of_bodies_are_read(
    three_arm_cell: Workcell, three_arm_env: ThreeArmEnv
) -> None:
    arms, scene = PlanningScene(three_arm_cell.task, three_arm_cell.scene()).arms, three_arm_cell.scene()
    for arm, qpos, robot in zip(arms, scene.qpos, three_arm_env.agent.agents, strict=True):  # pyright: ignore
        expected = robot.robot.links_map["panda_hand"]._objs[0].entity_pose.to_transformation_matrix()
        np.testing.assert_allclose(arm.links(qpos)[DEFAULT.links.index("panda_hand")], expected, atol=1e-4)
    assert len(arms) == len(BASES)
    assert set(three_arm_cell.task.objects) == {name.replace(" ", "_").replace("-", "_") for name in BODIES}
    sizes_m = {
        name: np.ptp(three_arm_cell.task.asset(name).bounds_m, axis=0) for name in three_arm_cell.task.objects
    }
    # Length, width and height; round shapes are enclosed by a polyhedron.
    assert sizes_m["box"] == pytest.approx((0.08, 0.04, 0.06), abs=1e-4)
    assert sizes_m["can"] == pytest.approx((0.06, 0.06, 0.1), rel=0.02)
    assert sizes_m["ball"] == pytest.approx((0.04, 0.04, 0.04), rel=0.05)
    assert sizes_m["pill"] == pytest.approx((0.1, 0.04, 0.04), rel=0.05)
    assert sizes_m["wedge"] == pytest.approx((0.06, 0.03, 0.04), abs=1e-4)
    for name, asset in ((name, three_arm_cell.task.asset(name)) for name in sizes_m):
        if asset.hulls:
            assert asset.vertices(scene.poses[name])[:, 2].min() == pytest.approx(
                0.06 if name == "on_top" else 0.0, abs=1e-3
            )


def test_interaction_points_follow_from_the_shape(three_arm_cell: Workcell) -> None:
    points = {name: set(points) for name, points in three_arm_cell.task.vocabulary.points.items()}
    assert points == {
        "box": {"center", "top"},
        "on_top": {"center", "top"},
        "ball": {"center"},  # no object can rest on it
        "can": {"center", "top"},
        "pill": {"center"},
        "wedge": {"center"},
        "wall": {"top"},  # a fixed body
        "Mark_1": {"middle"},
    }
    box = three_arm_cell.task.asset("box").points["center"]
    assert (box.width_m, box.turns) == (pytest.approx(0.04, abs=1e-4), 2)
    assert three_arm_cell.task.asset("on_top").points["center"].turns == 4
    assert {
        name: spec.relative_to for name, spec in three_arm_cell.task.objects.items() if spec.relative_to
    } == {"on_top": "box"}


def test_ignored_bodies_are_left_out(three_arm_env: ThreeArmEnv) -> None:
    three_arm_env.reset(seed=0)
    assert "wall" not in Workcell(three_arm_env, ignore=["wall", "on_top"]).task.objects


# -- planning and driving --------------------------------------------------------------------------


def test_a_cube_is_handed_over(cell: Workcell) -> None:
    plan = cell.plan(HANDOVER, ORDER)
    assert not plan.checked.violations
    execution = cell.execute(plan)
    assert execution.violation is None and not execution.terminated and not execution.truncated
    assert execution.scene.held == (None, "cube")
    assert execution.scene.poses["cube"][2, 3] == pytest.approx(0.1, abs=0.01)
    assert "not is_obj_placed" in execution.reason
    second_execution = cell.execute(cell.plan({2: ["place cube to middle"]}))  # from the current scene
    assert second_execution.scene.held == (None, None)
    np.testing.assert_allclose(second_execution.scene.poses["cube"][:3, 3], 0.0, atol=0.01)


def test_values_and_sentences_with_the_same_seed_give_the_same_plan(cell: Workcell) -> None:
    from_sentences = cell.plan(HANDOVER, ORDER, seed=3)
    from_values = cell.plan(
        {
            1: [Subgoal(1, "grasp", "cube", "center"), Subgoal(1, "place", "cube", target="middle")],
            2: [Subgoal(2, "grasp", "cube", "center"), Subgoal(2, "lift", "cube", height_m=0.1)],
        },
        [Before(Step(1, "place", "cube"), Step(2, "grasp", "cube"))],
        seed=3,
    )
    assert from_sentences.proposal == from_values.proposal
    for trajectory, other in zip(from_sentences.trajectories, from_values.trajectories, strict=True):
        np.testing.assert_array_equal(trajectory.path(), other.path())


def test_a_raised_and_tilted_arm_grasps_a_ball_and_a_stacked_object(three_arm_cell: Workcell) -> None:
    execution = three_arm_cell.execute(
        three_arm_cell.plan({3: ["grasp ball at center", "lift ball by 0.1 m"]})
    )
    assert execution.violation is None and execution.scene.held[2] == "ball"
    assert execution.scene.poses["ball"][2, 3] == pytest.approx(0.1, abs=0.01)
    assert execution.reason == "the plan was executed; the environment does not report success"
    subgoals = ["place ball to spot", "grasp on_top at center", "lift on_top by 0.1 m"]
    execution = three_arm_cell.execute(
        three_arm_cell.plan({3: subgoals}, ["Agent_3 must grasp On_Top at its center point."])
    )
    assert execution.violation is None and execution.scene.held[2] == "on_top"


def test_the_monitor_stops_a_failed_grasp(cell: Workcell, pick_cube: gymnasium.Env) -> None:
    """The cube is moved away before the grasp, so it is missing when it should be held."""
    plan = cell.plan(HANDOVER, ORDER)
    cube: Any = pick_cube.unwrapped.cube  # pyright: ignore[reportAttributeAccessIssue]
    pose = cube.pose.raw_pose.clone()
    pose[:, 0] += 0.2
    cube.set_pose(type(cube.pose)(pose))
    execution = cell.execute(plan)
    assert execution.violation is not None and execution.violation.check is CheckName.INTERACTION
    assert execution.steps < len(plan.schedule) and execution.reason == execution.violation.sentence
    assert np.abs(execution.scene.qvel[:, :7]).max() < 0.1  # at rest
    assert cell.execute(cell.plan(HANDOVER, ORDER)).scene.held == (None, "cube")  # a new plan


def test_the_step_limit_of_the_environment_ends_an_execution() -> None:
    env = make_environment(max_episode_steps=10)
    env.reset(seed=0)
    cell = Workcell(env, places={"middle": transform()})
    execution = cell.execute(cell.plan(HANDOVER, ORDER))
    assert (execution.steps, execution.truncated, execution.success) == (10, True, False)
    assert execution.reason == "the environment truncated the episode"
    env.close()


def test_one_arm_needs_no_dictionary() -> None:
    """ManiSkill's environments with one robot take an array."""
    env = make_environment("PickCube-v1")
    env.reset(seed=0)
    cell = Workcell(env, points={"goal_site": {"held": InteractionPoint(transform((0, 0, -0.02)), "place")}})
    execution = cell.execute(cell.plan({1: ["grasp cube at center", "carry cube to goal_site at held"]}))
    assert execution.success and execution.terminated and execution.reason == ""
    env.close()


# -- errors ----------------------------------------------------------------------------------------


def test_unreachable_and_blocked_objects_give_no_plan(cell: Workcell) -> None:
    with pytest.raises(NoPlan, match="Motion: Agent_2 cannot grasp cube at center: out of reach") as error:
        cell.plan({2: ["grasp cube at center"]})
    assert error.value.violation.agents == (2,)
    with pytest.raises(NoPlan, match="ValidateSpatialOccupancy"):
        cell.plan({1: ["grasp cube at center"]}, [KeepOut(1, (-0.3, -0.3, 0.0), (0.3, 0.0, 0.4))])


@pytest.mark.parametrize(
    ("subgoals", "constraints", "message"),
    [
        ({}, [], "there are no subgoals"),
        ({3: ["home"]}, [], "unknown agent in subgoals: 'Agent_3'; available: Agent_1, Agent_2"),
        ({1: ["grasp ball at center"]}, [], "no object 'ball' in subgoal .*; available: cube, goal_site"),
        ({1: ["grasp cube at side"]}, [], "cube has no interaction point 'side'; available: center, top"),
        ({1: ["throw cube"]}, [], "cannot read subgoal 'throw cube' of Agent_1; forms: grasp"),
        ({1: ["home"]}, ["Agent_1 must be quick."], "constraint .* is not understood"),
        ({1: ["home"]}, [ShareSpace((1, 3))], "unknown agent in constraint .*Agent_3"),
        ({1: ["home"]}, [Before(Step(1, "grasp", "cube"), Step(2))], "Agent_1 .*grasp cube"),
    ],
)
def test_invalid_subgoals_and_constraints_are_refused(
    cell: Workcell, subgoals: dict[int, list[str]], constraints: list[Any], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        cell.plan(subgoals, constraints)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"points": {"bowl": {}}}, "unknown object in points: 'bowl'; available: cube, goal_site"),
        ({"places": {"cube": transform()}}, "place 'cube' has the name of an object"),
        ({"ignore": ["bowl"]}, "unknown body to ignore 'bowl'; available: cube, goal_site, ground"),
    ],
)
def test_unknown_names_are_refused(pick_cube: gymnasium.Env, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Workcell(pick_cube, **options)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("TwoRobotPickCube-v1", {"control_mode": None}, "'pd_joint_delta_pos'; expected absolute joint"),
        ("TwoRobotPickCube-v1", {"control_mode": "pd_ee_delta_pose"}, "control_mode='pd_joint_pos'"),
        ("TwoRobotPickCube-v1", {"sim_config": {"control_freq": 10}}, "at 10 Hz; expected 20"),
        ("PickCube-v1", {"robot_uids": "fetch"}, "fetch has the joints .*; expected a Franka Panda"),
        (
            "DrawTriangle-v1",
            {"reward_mode": None},
            "panda_stick has the joints .*; expected a Franka Panda",
        ),
        ("MS-CartpoleBalance-v1", {"control_mode": None}, "expected a Franka Panda"),
    ],
)
def test_unsupported_environments_are_refused_with_the_reason(
    name: str, options: dict[str, Any], message: str
) -> None:
    env = make_environment(name, **options)
    with pytest.raises(ArgumentError, match=message):
        Workcell(env)
    env.close()


def test_parallel_and_gpu_environments_are_refused(
    pick_cube: gymnasium.Env, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ManiSkill makes these only on a GPU; here, patched attributes imitate them."""
    base: Any = pick_cube.unwrapped
    monkeypatch.setattr(base, "num_envs", 2)
    with pytest.raises(ArgumentError, match="2 parallel ones; expected num_envs=1"):
        Workcell(pick_cube)
    monkeypatch.undo()
    monkeypatch.setattr(type(base), "gpu_sim_enabled", True)
    with pytest.raises(ArgumentError, match="simulates on a GPU; expected sim_backend='physx_cpu'"):
        Workcell(pick_cube)


def test_other_environments_are_refused() -> None:
    with pytest.raises(ArgumentError, match="CartPoleEnv is no ManiSkill environment"):
        Workcell(gymnasium.make("CartPole-v1"))


def test_an_outdated_scene_or_plan_is_refused(cell: Workcell, pick_cube: gymnasium.Env) -> None:
    plan = cell.plan({1: ["aside"]})
    cell.execute(plan)
    with pytest.raises(ArgumentError, match=r"the plan is for step 0 .* plan again"):
        cell.execute(plan)
    pick_cube.reset(seed=1)
    with pytest.raises(ArgumentError, match="reset after its scene was read; read it again"):
        cell.plan({1: ["aside"]})
