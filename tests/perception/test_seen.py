"""From depth pictures to obstacles, without a simulator: points, robot bodies, boxes, obstacles per agent."""

import numpy as np
import pytest
import trimesh

from rf_exp.constraints import RoboChecker
from rf_exp.geometry import VOXEL_M, Piece, PlanningScene, Swept, nearest, voxels
from rf_exp.perception import (
    MIN_POINTS,
    NOISE_M,
    UNKNOWN_OBSTACLE,
    OccupancyMap,
    boxes,
    depth_points,
    down_to_table,
    near_body,
    occupied_voxels,
)
from rf_exp.robots import DEFAULT, Arm
from rf_exp.statements import Proposal
from rf_exp.transforms import apply, from_axes, inverse
from rf_exp.types import CameraModel, ConstraintSet, Schedule
from tests.constraints.robots import REACHING, REST, real, scene_of, team, walk

FOOD = real("place_food")
# 1 m above (0.3, 0.1), pointing straight down: the top of the picture is +x, its right -y.
CAMERA = CameraModel(64, 48, np.deg2rad(60), from_axes((0.3, 0.1, 1.0), z=(0, 0, -1), y=(-1, 0, 0)))


def block(low, high):
    """Voxels from `low` to `high` (exclusive), in lexical order."""
    return np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)


def point_body(point):
    """A cube of 0.2 mm at a point."""
    poses = np.eye(4)[None, None].copy()
    poses[0, 0, :3, 3] = point
    return Swept((Piece.of(trimesh.creation.box((2e-4,) * 3)),), ("dot",), poses)


def without_contacts(body):
    """The body without allowed contacts."""
    return Swept(body.pieces, body.labels, body.poses)


def as_set(occupied):
    return {*map(tuple, occupied.tolist())}


def test_pixels_become_points_in_front_of_the_camera():
    depth = np.full((48, 64), 1.0, dtype=np.float32)  # the table
    depth[:24, :32] = 0.7  # the upper left quarter shows an object of 30 cm height
    points = depth_points(depth, CAMERA)
    assert len(points) == 24 * 32
    assert points[:, 2] == pytest.approx(0.3)
    assert (points[:, 0] > 0.3).all() and (points[:, 1] > 0.1).all()
    reach_m = 0.7 * np.tan(np.deg2rad(30))
    assert points[:, 0].max() == pytest.approx(0.3 + reach_m * 47 / 48, abs=1e-4)
    pixels = apply(inverse(CAMERA.world_from_camera), points.astype(float)) @ CAMERA.intrinsics.T
    u, v = (pixels[:, :2] / pixels[:, 2:]).T
    np.testing.assert_allclose(u.reshape(24, 32)[0], np.arange(32) + 0.5, atol=1e-3)
    np.testing.assert_allclose(v.reshape(24, 32)[:, 0], np.arange(24) + 0.5, atol=1e-3)


def test_a_finer_picture_gives_the_same_points():
    coarse = CameraModel(320, 240, CAMERA.fov_y_rad, CAMERA.world_from_camera)
    fine = CameraModel(960, 720, CAMERA.fov_y_rad, CAMERA.world_from_camera)
    a = depth_points(np.full((240, 320), 0.8, dtype=np.float32), coarse)
    b = depth_points(np.full((720, 960), 0.8, dtype=np.float32), fine)
    assert len(a) == len(b) == 240 * 320  # one pixel of nine
    pixel_m = 0.8 / fine.intrinsics[0, 0]
    np.testing.assert_allclose(a - b, [[-pixel_m, -pixel_m, 0]] * len(a), atol=1e-4)


@pytest.mark.parametrize("no_depth", [0.0, np.inf, np.nan, 1.0, 1.5])
def test_pixels_without_depth_are_ignored(no_depth):
    depth = np.full((48, 64), no_depth, dtype=np.float32)
    planning_scene = PlanningScene(FOOD, scene_of(FOOD))
    assert occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene).shape == (0, 3)
    depth[:10, :10] = 0.8
    assert len(occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene)) > 3
    depth[:10, :10] = [[0.8] * (MIN_POINTS - 1) + [no_depth] * (11 - MIN_POINTS)] + [[no_depth] * 10] * 9
    assert len(occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene)) == 0


@pytest.mark.slow
def test_points_on_an_arm_and_its_held_object_are_removed():
    rng = np.random.default_rng(0)
    scene = scene_of(FOOD)
    tcp = Arm(DEFAULT, FOOD.robots[0].world_from_base).tcp(scene.qpos[0])
    scene = scene_of(FOOD, held=("steak", None), poses={**scene.poses, "steak": tcp})
    planning_scene = PlanningScene(FOOD, scene)
    for body in (planning_scene.arm(1, scene.qpos[0]), planning_scene.static_objects(["steak"])):
        for column, piece in enumerate(body.pieces):
            weights = rng.dirichlet(np.ones(len(piece.vertices)) / 4, 40)
            inside = apply(body.poses[0, column], weights @ piece.vertices)
            assert near_body(body, inside.astype(np.float32), 1e-5).all()
        low, high = (bound(body.centres[0], axis=0) for bound in (np.min, np.max))
        sampled = rng.uniform(low - 0.1, high + 0.1, (200, 3))
        gaps = np.array([gap.distance_m for point in sampled if (gap := nearest(body, point_body(point)))])
        is_near = near_body(body, sampled.astype(np.float32), NOISE_M)
        assert is_near[gaps < NOISE_M - 1e-4].all() and not is_near[gaps > 2 * NOISE_M].any()
        assert is_near.any() and not is_near.all()
    eye = from_axes(tcp[:3, 3] - [0.4, 0, 0], z=(1, 0, 0), y=(0, 0, -1))
    camera = CameraModel(8, 8, np.deg2rad(2), eye)
    depth = {"global": np.full((8, 8), 0.4, dtype=np.float32)}
    assert len(occupied_voxels(depth, {"global": camera}, planning_scene)) == 0


def test_voxels_become_boxes_of_the_same_volume_down_to_the_table():
    rng = np.random.default_rng(1)
    for count in (0, 1, 2, 60, 200):
        occupied = np.unique(rng.integers((-3, -3, 0), (3, 3, 6), (count, 3)), axis=0)
        filled = down_to_table(occupied)
        assert as_set(filled) == {(x, y, z) for x, y, top in as_set(occupied) for z in range(top + 1)}
        assert len(filled) == len(as_set(filled))
        body = boxes(filled)
        assert len(body.pieces) <= len(filled)
        corners = [
            apply(pose, piece.vertices) for pose, piece in zip(body.poses[0], body.pieces, strict=True)
        ]
        volume = sum(np.prod(np.ptp(corner, axis=0)) for corner in corners)
        assert volume == pytest.approx(len(filled) * VOXEL_M**3)
        inside = near_body(body, ((filled + 0.5) * VOXEL_M).astype(np.float32), -0.4 * VOXEL_M)
        assert inside.all()
    assert len(boxes(block((0, 0, 0), (4, 5, 6))).pieces) == 1


def test_obstacles_of_an_agent_are_all_voxels_except_its_objects():
    qpos = scene_of(FOOD).qpos + np.eye(9)[0] * 2.5  # turned away from all objects
    planning_scene = PlanningScene(FOOD, scene_of(FOOD, qpos=qpos))
    steak, pot = (
        voxels(planning_scene.static_objects(["steak"])),
        voxels(planning_scene.static_objects(["pot"])),
    )
    unknown = block((8, -9, 0), (10, -7, 3))
    around = block(steak.min(axis=0) - 1, steak.max(axis=0) + 2)
    gaps = (
        nearest(without_contacts(planning_scene.static_objects(["steak"])), boxes(each[None]))
        for each in around
    )
    near = around[[gap is not None and 0.02 < gap.distance_m < VOXEL_M for gap in gaps]]
    near = near[near[:, 2] == 0]
    everything = np.unique(np.concatenate([steak, pot, unknown, near]), axis=0)
    occupancy = OccupancyMap(PlanningScene(FOOD, scene_of(FOOD, qpos=qpos, occupied_voxels=everything)))

    def occupied(body):
        return as_set(everything[near_body(body, ((everything + 0.5) * VOXEL_M).astype(np.float32), 0.0)])

    body, exact_objects = occupancy.obstacles(1, {"steak"})
    assert body.labels and set(body.labels) == {UNKNOWN_OBSTACLE}
    assert "steak" in exact_objects
    assert occupied(body) >= as_set(unknown)
    # Voxels near the steak are not a part of it.
    assert as_set(near) and occupied(body) >= as_set(near) - as_set(pot)
    assert not occupied(body) & as_set(steak)
    assert occupied(body) >= {v for v in as_set(pot) if min(np.abs(steak - v).max(axis=1)) > 2}
    body, exact_objects = occupancy.obstacles(1, set())
    assert occupied(body) == as_set(everything) and exact_objects == frozenset()
    # The lid lies on the pot, so its shape replaces its voxels.
    body, exact_objects = occupancy.obstacles(1, {"pot"})
    assert exact_objects >= {"pot", "lid"} and occupied(body) >= as_set(unknown)
    assert not occupied(body) & as_set(pot)


def test_voxels_inside_an_arm_are_not_its_obstacles():
    scene = scene_of(FOOD)
    of_arm = voxels(PlanningScene(FOOD, scene).arm(1, scene.qpos[0]))
    unknown = block((8, -9, 0), (10, -7, 3))
    occupancy = OccupancyMap(
        PlanningScene(
            FOOD, scene_of(FOOD, occupied_voxels=np.unique(np.concatenate([of_arm, unknown]), axis=0))
        )
    )
    centres = [((each + 0.5) * VOXEL_M).astype(np.float32) for each in (of_arm, unknown)]
    for agent in FOOD.agents:
        body, _ = occupancy.obstacles(agent, set())
        assert near_body(body, centres[0], 0.0).any() == (agent != 1)
        assert near_body(body, centres[1], 0.0).all()


def test_an_unknown_box_from_depth_is_a_violation():
    task = team(1)
    target = Arm(DEFAULT, task.robots[0].world_from_base).tcp(REACHING)[:3, 3]
    corner = np.floor(target / VOXEL_M).astype(int)
    box = block(corner - [1, 1, 0], corner + np.array([2, 2, 1]))
    trajectories = (walk(1, [REST, REACHING, REST], 20),)

    def violations(**changes):
        scene, checker = (
            scene_of(task, **changes),
            RoboChecker(task, Proposal((), ()), ConstraintSet("full")),
        )
        timed = checker.schedule(checker.paths(trajectories, scene))
        assert isinstance(timed, Schedule)
        return checker.check(checker.paths(trajectories, scene), timed).violations

    assert violations() == []
    [violation] = violations(occupied_voxels=box)
    assert (
        violation.check == "ValidateSpatialOccupancy"
        and violation.agents == (1,)
        and UNKNOWN_OBSTACLE in violation.sentence
    )
    assert 0.2 < violation.time_s < 1.0  # on the way to the box
    assert violations(occupied_voxels=box + np.array([0, 40, 0])) == []
