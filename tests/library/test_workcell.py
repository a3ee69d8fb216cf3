"""Scenes of others are read as they are, planned for, and driven; what cannot be is refused in words."""

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
from tests.library.yard import BASES, STANDS, Yard

pytestmark = pytest.mark.slow

HANDOVER: dict[int, list[str]] = {
    1: ["grasp cube at center", "place cube to middle"],
    2: ["grasp cube at center", "lift cube by 0.1 m"],
}
ORDER = ("Agent_1 must place cube before Agent_2 grasps cube.",)


def stock(name: str = "TwoRobotPickCube-v1", **options: Any) -> gymnasium.Env:
    given = {"control_mode": "pd_joint_pos", "reward_mode": "none", "max_episode_steps": 600, **options}
    return gymnasium.make(name, obs_mode="none", render_backend="none", **given)


@pytest.fixture(scope="module")
def pick_cube() -> Iterator[gymnasium.Env]:
    env = stock()
    yield env
    env.close()


@pytest.fixture(scope="module")
def yard() -> Iterator[Yard]:
    env = Yard()
    yield env
    env.close()


@pytest.fixture
def cell(pick_cube: gymnasium.Env) -> Workcell:
    pick_cube.reset(seed=0)
    return Workcell(pick_cube, places={"middle": transform()})


@pytest.fixture
def crowd(yard: Yard) -> Workcell:
    yard.reset(seed=0)
    return Workcell(yard, places={"spot": transform((-0.2, 0.15, 0.0))})


# -- reading ---------------------------------------------------------------------------------------


def test_a_scene_is_read_as_it_stands(cell: Workcell) -> None:
    said = str(cell).splitlines()
    assert said[0] == "Agent_1: panda_wristcam-0 at (0, -0.75, 0)"
    assert said[2].startswith("cube at (") and said[2].endswith(": center (grasp), top (place)")
    assert said[3].startswith("goal_site at (") and said[3].endswith(": middle (place)")
    assert said[4:] == ["middle at (0, 0, 0): a place", "the table: table_workspace, ground"]


def test_what_sits_on_a_hand_is_kept_clear_too(cell: Workcell) -> None:
    """The camera of `panda_wristcam` is where PhysX has it."""
    body = PlanningScene(cell.task, cell.scene()).arm(1, cell.scene().qpos[0])
    links: list[Any] = cell._environment._joints[0].arm.links
    camera = next(link for link in links if link.name.endswith("camera_link"))
    shape = camera.collision_shapes[0]
    pose = (camera.entity_pose * shape.local_pose).to_transformation_matrix()
    piece, placed = body.pieces[len(DEFAULT.links)], body.poses[0, len(DEFAULT.links)]
    inside = apply(inverse(pose), apply(placed, piece.vertices))
    assert len(body.pieces) == len(DEFAULT.links) + 1
    np.testing.assert_allclose(np.abs(inside), np.tile(shape.half_size, (8, 1)), atol=1e-5)


def test_bases_and_bodies_of_every_kind_are_where_they_are(crowd: Workcell, yard: Yard) -> None:
    arms, scene = PlanningScene(crowd.task, crowd.scene()).arms, crowd.scene()
    for arm, qpos, robot in zip(arms, scene.qpos, yard.agent.agents, strict=True):  # pyright: ignore
        hand = robot.robot.links_map["panda_hand"]._objs[0].entity_pose.to_transformation_matrix()
        np.testing.assert_allclose(arm.links(qpos)[DEFAULT.links.index("panda_hand")], hand, atol=1e-4)
    assert len(arms) == len(BASES)
    assert set(crowd.task.objects) == {name.replace(" ", "_").replace("-", "_") for name in STANDS}
    sizes_m = {name: np.ptp(crowd.task.asset(name).bounds_m, axis=0) for name in crowd.task.objects}
    # Along, across and up; what is round is held by a polyhedron.
    assert sizes_m["box"] == pytest.approx((0.08, 0.04, 0.06), abs=1e-4)
    assert sizes_m["can"] == pytest.approx((0.06, 0.06, 0.1), rel=0.02)
    assert sizes_m["ball"] == pytest.approx((0.04, 0.04, 0.04), rel=0.05)
    assert sizes_m["pill"] == pytest.approx((0.1, 0.04, 0.04), rel=0.05)
    assert sizes_m["wedge"] == pytest.approx((0.06, 0.03, 0.04), abs=1e-4)
    for name, asset in ((name, crowd.task.asset(name)) for name in sizes_m):
        if asset.hulls:
            assert asset.vertices(scene.poses[name])[:, 2].min() == pytest.approx(
                0.06 if name == "on_top" else 0.0, abs=1e-3
            )


def test_points_follow_from_the_shape(crowd: Workcell) -> None:
    points = {name: set(points) for name, points in crowd.task.vocabulary.points.items()}
    assert points == {
        "box": {"center", "top"},
        "on_top": {"center", "top"},
        "ball": {"center"},  # nothing stays on it
        "can": {"center", "top"},
        "pill": {"center"},
        "wedge": {"center"},
        "wall": {"top"},  # it is fixed
        "Mark_1": {"middle"},
    }
    box = crowd.task.asset("box").points["center"]
    assert (box.width_m, box.turns) == (pytest.approx(0.04, abs=1e-4), 2)
    assert crowd.task.asset("on_top").points["center"].turns == 4
    assert {name: spec.relative_to for name, spec in crowd.task.objects.items() if spec.relative_to} == {
        "on_top": "box"
    }


def test_what_is_ignored_is_not_there(yard: Yard) -> None:
    yard.reset(seed=0)
    assert "wall" not in Workcell(yard, ignore=["wall", "on_top"]).task.objects


# -- planning and driving --------------------------------------------------------------------------


def test_a_cube_goes_from_hand_to_hand(cell: Workcell) -> None:
    plan = cell.plan(HANDOVER, ORDER)
    assert not plan.checked.violations
    ended = cell.execute(plan)
    assert ended.violation is None and not ended.terminated and not ended.truncated
    assert ended.scene.held == (None, "cube")
    assert ended.scene.poses["cube"][2, 3] == pytest.approx(0.1, abs=0.01)
    assert "not is_obj_placed" in ended.reason
    again = cell.execute(cell.plan({2: ["place cube to middle"]}))  # from where it stands now
    assert again.scene.held == (None, None)
    np.testing.assert_allclose(again.scene.poses["cube"][:3, 3], 0.0, atol=0.01)


def test_values_are_as_good_as_sentences_and_the_same_seed_is_the_same_plan(cell: Workcell) -> None:
    said = cell.plan(HANDOVER, ORDER, seed=3)
    meant = cell.plan(
        {
            1: [Subgoal(1, "grasp", "cube", "center"), Subgoal(1, "place", "cube", target="middle")],
            2: [Subgoal(2, "grasp", "cube", "center"), Subgoal(2, "lift", "cube", height_m=0.1)],
        },
        [Before(Step(1, "place", "cube"), Step(2, "grasp", "cube"))],
        seed=3,
    )
    assert said.proposal == meant.proposal
    for one, other in zip(said.trajectories, meant.trajectories, strict=True):
        np.testing.assert_array_equal(one.path(), other.path())


def test_a_raised_and_tilted_arm_takes_a_ball_and_a_thing_from_a_thing(crowd: Workcell) -> None:
    ended = crowd.execute(crowd.plan({3: ["grasp ball at center", "lift ball by 0.1 m"]}))
    assert ended.violation is None and ended.scene.held[2] == "ball"
    assert ended.scene.poses["ball"][2, 3] == pytest.approx(0.1, abs=0.01)
    assert ended.reason == "the plan was executed; the environment does not report success"
    then = ["place ball to spot", "grasp on_top at center", "lift on_top by 0.1 m"]
    ended = crowd.execute(crowd.plan({3: then}, ["Agent_3 must grasp On_Top at its center point."]))
    assert ended.violation is None and ended.scene.held[2] == "on_top"


def test_the_monitor_stops_what_goes_wrong(cell: Workcell, pick_cube: gymnasium.Env) -> None:
    """The cube is taken away while the arm comes for it: it is missed when it should be held."""
    plan = cell.plan(HANDOVER, ORDER)
    cube: Any = pick_cube.unwrapped.cube  # pyright: ignore[reportAttributeAccessIssue]
    pose = cube.pose.raw_pose.clone()
    pose[:, 0] += 0.2
    cube.set_pose(type(cube.pose)(pose))
    ended = cell.execute(plan)
    assert ended.violation is not None and ended.violation.check is CheckName.INTERACTION
    assert ended.steps < len(plan.schedule) and ended.reason == ended.violation.sentence
    assert np.abs(ended.scene.qvel[:, :7]).max() < 0.1  # at rest
    assert cell.execute(cell.plan(HANDOVER, ORDER)).scene.held == (None, "cube")  # planned anew


def test_the_environment_s_own_limit_ends_an_execution() -> None:
    env = stock(max_episode_steps=10)
    env.reset(seed=0)
    cell = Workcell(env, places={"middle": transform()})
    ended = cell.execute(cell.plan(HANDOVER, ORDER))
    assert (ended.steps, ended.truncated, ended.success) == (10, True, False)
    assert ended.reason == "the environment truncated the episode"
    env.close()


def test_one_arm_needs_no_dictionary() -> None:
    """ManiSkill's environments of one robot take one array."""
    env = stock("PickCube-v1")
    env.reset(seed=0)
    cell = Workcell(env, points={"goal_site": {"held": InteractionPoint(transform((0, 0, -0.02)), "place")}})
    ended = cell.execute(cell.plan({1: ["grasp cube at center", "carry cube to goal_site at held"]}))
    assert ended.success and ended.terminated and ended.reason == ""
    env.close()


# -- what cannot be --------------------------------------------------------------------------------


def test_what_is_out_of_reach_or_in_the_way_is_no_plan(cell: Workcell) -> None:
    with pytest.raises(NoPlan, match="Motion: Agent_2 cannot grasp cube at center: out of reach") as refused:
        cell.plan({2: ["grasp cube at center"]})
    assert refused.value.violation.agents == (2,)
    with pytest.raises(NoPlan, match="ValidateSpatialOccupancy"):
        cell.plan({1: ["grasp cube at center"]}, [KeepOut(1, (-0.3, -0.3, 0.0), (0.3, 0.0, 0.4))])


@pytest.mark.parametrize(
    ("subgoals", "constraints", "says"),
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
def test_words_that_mean_nothing_here_are_refused(
    cell: Workcell, subgoals: dict[int, list[str]], constraints: list[Any], says: str
) -> None:
    with pytest.raises(ArgumentError, match=says):
        cell.plan(subgoals, constraints)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"points": {"bowl": {}}}, "unknown object in points: 'bowl'; available: cube, goal_site"),
        ({"places": {"cube": transform()}}, "place 'cube' has the name of an object"),
        ({"ignore": ["bowl"]}, "unknown body to ignore 'bowl'; available: cube, goal_site, ground"),
    ],
)
def test_names_that_the_scene_does_not_have_are_refused(
    pick_cube: gymnasium.Env, options: dict[str, Any], says: str
) -> None:
    with pytest.raises(ArgumentError, match=says):
        Workcell(pick_cube, **options)


@pytest.mark.parametrize(
    ("name", "options", "says"),
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
def test_environments_that_are_not_supported_say_why(name: str, options: dict[str, Any], says: str) -> None:
    env = stock(name, **options)
    with pytest.raises(ArgumentError, match=says):
        Workcell(env)
    env.close()


def test_several_environments_in_one_and_those_on_a_gpu_are_refused(
    pick_cube: gymnasium.Env, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ManiSkill makes such only where there is a GPU: here one says of itself that it is one."""
    base: Any = pick_cube.unwrapped
    monkeypatch.setattr(base, "num_envs", 2)
    with pytest.raises(ArgumentError, match="2 parallel ones; expected num_envs=1"):
        Workcell(pick_cube)
    monkeypatch.undo()
    monkeypatch.setattr(type(base), "gpu_sim_enabled", True)
    with pytest.raises(ArgumentError, match="simulates on a GPU; expected sim_backend='physx_cpu'"):
        Workcell(pick_cube)


def test_what_is_no_maniskill_environment_is_refused() -> None:
    with pytest.raises(ArgumentError, match="CartPoleEnv is no ManiSkill environment"):
        Workcell(gymnasium.make("CartPole-v1"))


def test_a_scene_and_a_plan_that_are_over_are_refused(cell: Workcell, pick_cube: gymnasium.Env) -> None:
    plan = cell.plan({1: ["aside"]})
    cell.execute(plan)
    with pytest.raises(ArgumentError, match=r"the plan is for step 0 .* plan again"):
        cell.execute(plan)
    pick_cube.reset(seed=1)
    with pytest.raises(ArgumentError, match="reset after its scene was read; read it again"):
        cell.plan({1: ["aside"]})
