"""Voxels of a volume: complete, nearly tight, and shared by bodies in contact."""

import numpy as np
import pytest
import trimesh

from rf_exp.geometry import (
    VOXEL_M,
    Piece,
    PlanningScene,
    centres_m,
    nearest,
    overlap,
    shared,
    voxels,
    within_margin,
)
from rf_exp.geometry.occupancy import fill
from rf_exp.geometry.swept import arm_pieces
from rf_exp.perception import boxes
from rf_exp.robots import DEFAULT
from rf_exp.transforms import apply
from tests.constraints.robots import random_qpos, scene_of, team

TWO = team(2)


def voxels_of(points):
    return {*map(tuple, np.floor(points / VOXEL_M).astype(int).tolist())}


def sample_points(piece: Piece, count: int, rng: np.random.Generator):
    weights = rng.dirichlet(np.full(len(piece.vertices), 0.05), count)
    return np.concatenate([weights @ piece.vertices, piece.vertices])


def test_every_point_of_every_link_lies_in_an_occupied_voxel():
    rng = np.random.default_rng(0)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    for qpos in random_qpos(rng, 6):
        body = planning_scene.arm(1, qpos)
        occupied = {*map(tuple, voxels(body).tolist())}
        for piece, pose in zip(body.pieces, body.poses[0], strict=True):
            assert voxels_of(apply(pose, sample_points(piece, 800, rng))) <= occupied


@pytest.mark.slow
def test_voxels_are_nearly_tight():
    """Every occupied voxel is less than a voxel away from the arm, and most contain a part of it."""
    body = PlanningScene(TWO, scene_of(TWO)).arm(1, random_qpos(np.random.default_rng(1), 1))
    samples = np.concatenate(
        [
            apply(pose, sample_points(piece, 6000, np.random.default_rng(2)))
            for piece, pose in zip(arm_pieces(DEFAULT), body.poses[0], strict=True)
        ]
    )
    centres = centres_m(voxels(body))
    gaps = np.array([np.abs(samples - centre).max(axis=1).min() for centre in centres])
    assert gaps.max() < VOXEL_M
    assert (gaps < 0.6 * VOXEL_M).mean() > 0.8


def test_finer_voxels_contain_every_point_and_lie_in_the_coarse_ones():
    rng = np.random.default_rng(5)
    body = PlanningScene(TWO, scene_of(TWO)).arm(1, random_qpos(rng, 1))
    coarse = {*map(tuple, voxels(body).tolist())}
    fine = voxels(body, voxel_m=VOXEL_M / 2)
    assert {*map(tuple, (fine // 2).tolist())} == coarse
    filled = {*map(tuple, fine.tolist())}
    for piece, pose in zip(body.pieces, body.poses[0], strict=True):
        points = apply(pose, sample_points(piece, 800, rng))
        assert {*map(tuple, np.floor(points / (VOXEL_M / 2)).astype(int).tolist())} <= filled


@pytest.mark.slow
def test_touching_arms_share_a_voxel_and_few_others_do():
    rng = np.random.default_rng(4)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    touched = false_alarms = clear = 0
    for _ in range(120):
        a, b = planning_scene.arm(1, random_qpos(rng, 1)), planning_scene.arm(2, random_qpos(rng, 1))
        share_voxel = len(shared(voxels(a), voxels(b))) > 0
        if overlap(a, b) is not None:
            touched += 1
            assert share_voxel
        else:
            clear += 1
            false_alarms += share_voxel
    assert touched > 10
    assert false_alarms < 0.4 * clear  # of the voxels alone; the exact test after them has none


def test_a_box_fills_the_voxels_it_enters():
    piece = Piece.of(trimesh.creation.box((0.09, 0.04, 0.04)))
    pose = np.eye(4)
    pose[:3, 3] = 0.025
    expected = {(-1, 0, 0), (0, 0, 0), (1, 0, 0)}
    assert {*map(tuple, fill(piece, pose).tolist())} == expected
    assert centres_m(np.array([[0, 0, 0]])) == pytest.approx(np.full((1, 3), 0.025))


def test_shared_voxels_are_sorted_and_may_be_none():
    a, b = np.array([[0, 0, 0], [1, 0, 0]]), np.array([[1, 0, 0], [2, 0, 0]])
    assert shared(a, b).tolist() == [[1, 0, 0]]
    assert shared(a, b + 5).shape == (0, 3)
    far = np.array([[9, -8, 7], [-9, 8, -7], [-9, -8, 7]])
    assert shared(far, np.concatenate([far, a])).tolist() == sorted(far.tolist())


@pytest.mark.slow
@pytest.mark.parametrize("margin_m", [0.0, 0.03])
def test_voxels_within_a_margin_of_a_body(margin_m):
    body = PlanningScene(TWO, scene_of(TWO)).arm(1, random_qpos(np.random.default_rng(6), 1))
    centre = np.floor(body.centres[0].mean(axis=0) / VOXEL_M).astype(int)
    sampled = np.random.default_rng(7).integers(centre - 8, centre + 8, (600, 3))
    gaps = [nearest(body, boxes(cube[None])) for cube in sampled]
    gaps_m = np.array([gap.distance_m for gap in gaps if gap is not None])
    is_near = within_margin(sampled, body, margin_m)
    assert is_near[gaps_m < margin_m - 1e-6].all()
    assert not is_near[gaps_m > 2 * margin_m + 0.01].any()
    assert 20 < is_near.sum() < 300
