"""Clutter: properties of the draws of a seed, and of the task of its scene, for all tasks."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from shapely import MultiPoint, Point

from rf_exp.errors import ArgumentError
from rf_exp.geometry import PlanningScene, closer_than, nearest
from rf_exp.tasks import Task, Variation, load_task, read_variation, scene_draws
from rf_exp.tasks.task.clutter import CLUTTER_KINDS, MARGIN_M, MIN_GAP_M, clutter_asset, random_piece, zones
from tests.conftest import read_task

CLUTTER, INSTANCES = read_variation("clutter"), read_variation("instances")
SEEDS = range(4)


def outline(piece):
    return MultiPoint(piece.asset.vertices(piece.world_from_object)[:, :2]).convex_hull


@pytest.mark.slow
def test_clutter_is_apart_from_the_objects_of_a_task(task: Task) -> None:
    """For any seed of the objects: their whole ranges are free, and so are places, bases and grippers."""
    starts = [task.start(seed) for seed in range(20)]
    for seed in SEEDS:
        scene = replace(task, variation=CLUTTER).in_scene(seed)
        kept_free, _ = zones(task, task.places(scene.start(seed).scene))
        outlines = [outline(piece) for piece in scene.clutter.values()]
        assert 3 <= len(outlines) <= 8
        assert all(one.distance(other) >= MIN_GAP_M for one, other in combinations(outlines, 2))
        assert not any(kept_free.intersects(each) for each in outlines)
        for start in starts:
            for name, pose in start.poses.items():
                asset = task.asset(name)
                within = np.concatenate([part.mesh.vertices for part in asset.parts]) @ pose[:3, :3].T
                object_outline = MultiPoint(within[:, :2] + pose[:2, 3]).convex_hull
                assert all(each.distance(object_outline) >= 0.9 * MARGIN_M for each in outlines)
        for robot in task.robots:
            assert all(each.distance(Point(robot.x_m, robot.y_m)) > 0.2 for each in outlines)


@pytest.mark.slow
def test_clutter_is_an_obstacle_and_arms_start_clear_of_it(task: Task) -> None:
    for variation in (CLUTTER, INSTANCES, replace(CLUTTER, object_size=(1.5, 1.5))):
        for seed in SEEDS[:2]:
            scene = replace(task, variation=variation).in_scene(seed)
            world = PlanningScene(scene, scene.start(seed).scene)
            static_body = world.static_objects()
            assert {*scene.clutter} <= {*static_body.labels}
            for agent in scene.agents:
                assert not closer_than(world.measured(agent), static_body, 0.0).any(), (seed, agent)


@pytest.mark.slow
def test_an_arm_that_reaches_into_clutter_is_in_collision() -> None:
    task = replace(read_task("pick_meat"), variation=replace(CLUTTER, clutter=(10, 10))).in_scene(0)
    scene = task.start(0).scene
    name, piece = next(iter(task.clutter.items()))
    gripper_m = task.arms[1].tcp(task.robots[0].rest_qpos)[:3, 3]
    pose = piece.world_from_object.copy()
    pose[:3, 3] = gripper_m[0], gripper_m[1], gripper_m[2] - 0.02
    world = PlanningScene(task, replace(scene, clutter={**scene.clutter, name: pose}))
    gap = nearest(world.measured(1), world.static_objects())
    assert gap is not None and gap.distance_m < 0 and gap.b == name


def test_clutter_is_not_in_vocabulary_and_poses(task: Task) -> None:
    scene = replace(task, variation=CLUTTER).in_scene(1)
    assert scene.clutter and scene.vocabulary == task.vocabulary
    assert {*scene.start(1).poses} == {*task.objects} == {*scene.objects}
    assert {*scene.start(1).scene.clutter} == {*scene.clutter}
    assert not task.clutter and not task.start(1).scene.clutter


@pytest.mark.slow
def test_a_scene_reports_clutter_without_a_place() -> None:
    task = read_task("lift_barrier")
    crowded = replace(task, variation=Variation("x", clutter=(10, 10), clutter_area_m=(0.34, 0.59)))
    drawn = [scene_draws(crowded, seed) for seed in SEEDS]
    assert any(each["clutter_left_out"] for each in drawn)
    for seed, each in zip(SEEDS, drawn, strict=True):
        assert len(each["clutter"]) + each["clutter_left_out"] == 10
        pieces = crowded.in_scene(seed).clutter
        assert {name: one["x_m"] for name, one in each["clutter"].items()} == {
            name: piece.x_m for name, piece in pieces.items()
        }
    assert drawn == [scene_draws(crowded, seed) for seed in SEEDS]


def test_clutter_cannot_be_configured_in_task_files() -> None:
    with pytest.raises(ArgumentError, match="task 'pick_meat': unknown field clutter"):
        load_task("pick_meat", {"name": "pick_meat", "clutter": {}})


def test_evaluation_has_other_shapes_in_other_colours() -> None:
    assert CLUTTER.held_out == replace(CLUTTER, clutter_set="unseen")
    assert INSTANCES.held_out is INSTANCES
    assert not {*CLUTTER_KINDS["seen"]} & {*CLUTTER_KINDS["unseen"]}
    kinds, hues = {}, {}
    for clutter_set in CLUTTER_KINDS:
        pieces = [random_piece(clutter_set, np.random.default_rng(seed)) for seed in range(300)]
        kinds[clutter_set] = {piece.kind for piece in pieces}
        hues[clutter_set] = {int(_hue(colour) // 60) for piece in pieces for colour in piece.colours}
        assert kinds[clutter_set] == {*CLUTTER_KINDS[clutter_set]}
    assert hues == {"seen": {0, 2, 4}, "unseen": {1, 3, 5}}


def _hue(colour) -> float:
    from colorsys import rgb_to_hsv

    return (360 * rgb_to_hsv(*colour)[0] + 1e-6) % 360


@pytest.mark.parametrize(("of", "kind"), [(of, kind) for of in CLUTTER_KINDS for kind in CLUTTER_KINDS[of]])
def test_pieces_are_convex_and_stable(of: str, kind: str) -> None:
    _, least, most = CLUTTER_KINDS[of][kind]
    for size in (least, most):
        asset = clutter_asset(of, kind, size, (0.5, 0.1, 0.1), (0.1, 0.1, 0.5))
        assert all(hull.is_watertight and hull.is_convex and hull.volume > 0 for hull in asset.hulls)
        low, high = (bounds for bounds in asset.bounds_m)
        assert low[2] == pytest.approx(0, abs=1e-9)
        np.testing.assert_allclose(high - low, size, atol=0.012)
        volumes = np.array([hull.volume for hull in asset.hulls])
        centre = np.average([hull.center_mass for hull in asset.hulls], axis=0, weights=volumes)
        foot = asset.vertices(np.eye(4))
        foot = MultiPoint(foot[foot[:, 2] < 1e-6][:, :2]).convex_hull
        assert foot.buffer(-0.01).contains(Point(centre[:2]))
        assert 0.01 < asset.mass_kg < 1.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"object_size": (0.2, 1.0)},
            "variation.object_size is [0.2, 1.0]; expected [LOW, HIGH] within [0.5, 1.5]",
        ),
        ({"clutter": (3, 20)}, "variation.clutter is [3, 20]; expected [LOW, HIGH] within [0, 10]"),
        ({"clutter_set": "new"}, "unknown variation.clutter_set 'new'; available: seen, unseen"),
        (
            {"clutter_area_m": (0.0, 1.0)},
            "variation.clutter_area_m is [0.0, 1.0]; expected two numbers, 0 < m <= 2",
        ),
    ],
)
def test_an_impossible_range_is_reported(changes, said) -> None:
    with pytest.raises(ArgumentError) as error:
        Variation(**changes)
    assert str(error.value) == said
