"""From depth pictures to obstacles, without a simulator: points, joint states, boxes, and who minds what."""

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
# Straight down from 1 m above (0.3, 0.1): the top of the picture is +x, its right -y.
CAMERA = CameraModel(64, 48, np.deg2rad(60), from_axes((0.3, 0.1, 1.0), z=(0, 0, -1), y=(-1, 0, 0)))


def block(low, high):
    """Voxels from one corner to before the other, in lexical order."""
    return np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)


def dot(point):
    """A body of 0.2 mm at a point."""
    poses = np.eye(4)[None, None].copy()
    poses[0, 0, :3, 3] = point
    return Swept((Piece.of(trimesh.creation.box((2e-4,) * 3)),), ("dot",), poses)


def as_links(body):
    """Pieces that everything else has to keep clear of."""
    return Swept(body.pieces, body.labels, body.poses)


def rows(occupied):
    return {*map(tuple, occupied.tolist())}


def test_pixels_become_points_where_the_camera_looks():
    depth = np.full((48, 64), 1.0, dtype=np.float32)  # the table
    depth[:24, :32] = 0.7  # the upper left quarter sees something 30 cm high
    found = depth_points(depth, CAMERA)
    assert len(found) == 24 * 32
    assert found[:, 2] == pytest.approx(0.3)
    assert (found[:, 0] > 0.3).all() and (found[:, 1] > 0.1).all()
    reach_m = 0.7 * np.tan(np.deg2rad(30))
    assert found[:, 0].max() == pytest.approx(0.3 + reach_m * 47 / 48, abs=1e-4)
    pixels = apply(inverse(CAMERA.world_from_camera), found.astype(float)) @ CAMERA.intrinsics.T
    u, v = (pixels[:, :2] / pixels[:, 2:]).T
    np.testing.assert_allclose(u.reshape(24, 32)[0], np.arange(32) + 0.5, atol=1e-3)
    np.testing.assert_allclose(v.reshape(24, 32)[:, 0], np.arange(24) + 0.5, atol=1e-3)


def test_a_finer_picture_gives_points_at_the_same_places():
    coarse = CameraModel(320, 240, CAMERA.fov_y_rad, CAMERA.world_from_camera)
    fine = CameraModel(960, 720, CAMERA.fov_y_rad, CAMERA.world_from_camera)
    a = depth_points(np.full((240, 320), 0.8, dtype=np.float32), coarse)
    b = depth_points(np.full((720, 960), 0.8, dtype=np.float32), fine)
    assert len(a) == len(b) == 240 * 320  # one of nine
    pixel_m = 0.8 / fine.intrinsics[0, 0]
    np.testing.assert_allclose(a - b, [[-pixel_m, -pixel_m, 0]] * len(a), atol=1e-4)


@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan, 1.0, 1.5])
def test_where_nothing_is_measured_nothing_is_seen(nothing):
    depth = np.full((48, 64), nothing, dtype=np.float32)
    planning_scene = PlanningScene(FOOD, scene_of(FOOD))
    assert occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene).shape == (0, 3)
    depth[:10, :10] = 0.8
    assert len(occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene)) > 3
    depth[:10, :10] = [[0.8] * (MIN_POINTS - 1) + [nothing] * (11 - MIN_POINTS)] + [[nothing] * 10] * 9
    assert len(occupied_voxels({"global": depth}, {"global": CAMERA}, planning_scene)) == 0


@pytest.mark.slow
def test_points_on_an_arm_and_on_what_it_holds_are_theirs():
    rng = np.random.default_rng(0)
    scene = scene_of(FOOD)
    grip = Arm(DEFAULT, FOOD.robots[0].world_from_base).tcp(scene.qpos[0])
    scene = scene_of(FOOD, held=("steak", None), poses={**scene.poses, "steak": grip})
    planning_scene = PlanningScene(FOOD, scene)
    for body in (planning_scene.arm(1, scene.qpos[0]), planning_scene.static_objects(["steak"])):
        for column, piece in enumerate(body.pieces):
            weights = rng.dirichlet(np.ones(len(piece.vertices)) / 4, 40)
            inside = apply(body.poses[0, column], weights @ piece.vertices)
            assert near_body(body, inside.astype(np.float32), 1e-5).all()
        low, high = (bound(body.centres[0], axis=0) for bound in (np.min, np.max))
        around = rng.uniform(low - 0.1, high + 0.1, (200, 3))
        gaps = np.array([gap.distance_m for point in around if (gap := nearest(body, dot(point)))])
        near = near_body(body, around.astype(np.float32), NOISE_M)
        assert near[gaps < NOISE_M - 1e-4].all() and not near[gaps > 2 * NOISE_M].any()
        assert near.any() and not near.all()
    eye = from_axes(grip[:3, 3] - [0.4, 0, 0], z=(1, 0, 0), y=(0, 0, -1))
    camera = CameraModel(8, 8, np.deg2rad(2), eye)
    depth = {"global": np.full((8, 8), 0.4, dtype=np.float32)}
    assert len(occupied_voxels(depth, {"global": camera}, planning_scene)) == 0


def test_voxels_become_boxes_of_the_same_volume_down_to_the_table():
    rng = np.random.default_rng(1)
    for count in (0, 1, 2, 60, 200):
        seen = np.unique(rng.integers((-3, -3, 0), (3, 3, 6), (count, 3)), axis=0)
        filled = down_to_table(seen)
        assert rows(filled) == {(x, y, z) for x, y, top in rows(seen) for z in range(top + 1)}
        assert len(filled) == len(rows(filled))
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


def test_an_agent_minds_all_that_is_seen_but_what_it_is_about():
    aside = scene_of(FOOD).qpos + np.eye(9)[0] * 2.5  # turned away from all of it
    planning_scene = PlanningScene(FOOD, scene_of(FOOD, qpos=aside))
    steak, pot = (
        voxels(planning_scene.static_objects(["steak"])),
        voxels(planning_scene.static_objects(["pot"])),
    )
    stranger = block((8, -9, 0), (10, -7, 3))
    around = block(steak.min(axis=0) - 1, steak.max(axis=0) + 2)
    gaps = (nearest(as_links(planning_scene.static_objects(["steak"])), boxes(each[None])) for each in around)
    close = around[[gap is not None and 0.02 < gap.distance_m < VOXEL_M for gap in gaps]]
    close = close[close[:, 2] == 0]
    everything = np.unique(np.concatenate([steak, pot, stranger, close]), axis=0)
    seen = OccupancyMap(PlanningScene(FOOD, scene_of(FOOD, qpos=aside, occupied_voxels=everything)))

    def occupied(body):
        return rows(everything[near_body(body, ((everything + 0.5) * VOXEL_M).astype(np.float32), 0.0)])

    body, exactly = seen.obstacles(1, {"steak"})
    assert body.labels and set(body.labels) == {UNKNOWN_OBSTACLE}
    assert "steak" in exactly
    assert occupied(body) >= rows(stranger)
    assert rows(close) and occupied(body) >= rows(close) - rows(pot)  # not the steak's, however near
    assert not occupied(body) & rows(steak)
    assert occupied(body) >= {v for v in rows(pot) if min(np.abs(steak - v).max(axis=1)) > 2}
    body, exactly = seen.obstacles(1, set())
    assert occupied(body) == rows(everything) and exactly == frozenset()
    body, exactly = seen.obstacles(1, {"pot"})  # the lid lies on the pot: it stands in for its voxels
    assert exactly >= {"pot", "lid"} and occupied(body) >= rows(stranger)
    assert not occupied(body) & rows(pot)


def test_an_arm_does_not_mind_the_voxels_it_stands_in():
    scene = scene_of(FOOD)
    stood_in = voxels(PlanningScene(FOOD, scene).arm(1, scene.qpos[0]))
    stranger = block((8, -9, 0), (10, -7, 3))
    seen = OccupancyMap(
        PlanningScene(
            FOOD, scene_of(FOOD, occupied_voxels=np.unique(np.concatenate([stood_in, stranger]), axis=0))
        )
    )
    middles = [((each + 0.5) * VOXEL_M).astype(np.float32) for each in (stood_in, stranger)]
    for agent in FOOD.agents:
        body, _ = seen.obstacles(agent, set())
        assert near_body(body, middles[0], 0.0).any() == (agent != 1)
        assert near_body(body, middles[1], 0.0).all()


def test_a_box_that_only_the_cameras_know_is_a_violation():
    alone = team(1)
    there = Arm(DEFAULT, alone.robots[0].world_from_base).tcp(REACHING)[:3, 3]
    corner = np.floor(there / VOXEL_M).astype(int)
    box = block(corner - [1, 1, 0], corner + np.array([2, 2, 1]))
    trajectories = (walk(1, [REST, REACHING, REST], 20),)

    def violations(**changes):
        scene, checker = (
            scene_of(alone, **changes),
            RoboChecker(alone, Proposal((), ()), ConstraintSet("full")),
        )
        timed = checker.schedule(checker.paths(trajectories, scene))
        assert isinstance(timed, Schedule)
        return checker.check(checker.paths(trajectories, scene), timed).violations

    assert violations() == []
    [found] = violations(occupied_voxels=box)
    assert (
        found.check == "ValidateSpatialOccupancy"
        and found.agents == (1,)
        and UNKNOWN_OBSTACLE in found.sentence
    )
    assert 0.2 < found.time_s < 1.0  # on the way there
    assert violations(occupied_voxels=box + np.array([0, 40, 0])) == []
