"""Diagrams and distances against brute force with coal over every pair of links."""

from dataclasses import replace

import coal
import numpy as np
import pytest
import trimesh

from rf_exp.geometry import (
    Piece,
    PlanningScene,
    Swept,
    clearance,
    closer_than,
    nearest,
    overlap,
    self_collisions,
)
from rf_exp.geometry.clearance import FORBID_TOLERANCE, SLACK_M
from rf_exp.robots import DEFAULT
from rf_exp.transforms import transform
from tests.constraints.robots import REST, arms, random_qpos, scene_of, team

TWO = team(2)


def brute(a: Swept, b: Swept, row: int, column: int) -> float:
    """The exact distance of two bodies: the least over all pairs of pieces, nothing skipped."""
    request, best = coal.DistanceRequest(), np.inf
    for i, x in enumerate(a.pieces):
        for j, y in enumerate(b.pieces):
            best = min(
                best,
                coal.distance(
                    x.shape,
                    a.coal_transform(row, i),
                    y.shape,
                    b.coal_transform(column, j),
                    request,
                    coal.DistanceResult(),
                ),
            )
    return best


@pytest.mark.parametrize("margin_m", [0.0, 0.02])
def test_the_diagram_is_the_exact_test_of_every_cell(margin_m):
    a, b = arms(TWO, np.random.default_rng(3), 14)
    exact = np.array([[brute(a, b, r, c) for c in range(14)] for r in range(14)])
    diagram = closer_than(a, b, margin_m, between=False)
    assert 5 < diagram.sum() < 190  # both outcomes are there
    assert exact[~diagram].min() >= margin_m
    assert exact[diagram].max() <= (1 + FORBID_TOLERANCE) * margin_m + 2 * SLACK_M


def test_long_smooth_paths_agree_with_brute_force_at_random_cells():
    rng = np.random.default_rng(4)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    keys = [random_qpos(rng, 5) for _ in range(2)]
    paths = [
        np.stack([np.interp(np.linspace(0, 4, 120), range(5), key[:, k]) for k in range(7)], axis=1)
        for key in keys
    ]
    a, b = planning_scene.arm(1, paths[0]), planning_scene.arm(2, paths[1])
    diagram = closer_than(a, b, 0.01, between=False)
    cells = rng.integers(0, 120, (400, 2))
    edge = np.argwhere(diagram[1:, 1:] != diagram[:-1, 1:])[:60]  # where it is decided
    for row, column in np.concatenate([cells, edge]).tolist():
        exact = brute(a, b, row, column)
        assert exact < (1 + FORBID_TOLERANCE) * 0.01 + 2 * SLACK_M if diagram[row, column] else exact >= 0.01


@pytest.mark.slow
def test_what_is_forbidden_between_positions_is_not_more_than_the_doubt():
    """Both sides of the limit, over every cell of smooth paths: what pieces have to spare."""
    rng = np.random.default_rng(11)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    sweep = np.linspace(0, 1, 40)[:, None]
    keys = random_qpos(rng, 2), random_qpos(rng, 2)
    a, b = (planning_scene.arm(k + 1, key[0] + sweep * (key[1] - key[0])) for k, key in enumerate(keys))
    margin_m = 0.01
    spare = np.full((40, 40), np.inf)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for row, column, i, j in np.ndindex(40, 40, len(a.pieces), len(b.pieces)):
        keep = margin_m + (a.stride_m[row, i] + b.stride_m[column, j]) / 2
        apart = np.linalg.norm(a.centres[row, i] - b.centres[column, j]) - a.radii_m[i] - b.radii_m[j]
        if apart - keep < min(spare[row, column], margin_m):
            result.clear()
            at = a.coal_transform(row, i), b.coal_transform(column, j)
            exact = coal.distance(a.pieces[i].shape, at[0], b.pieces[j].shape, at[1], request, result)
            spare[row, column] = min(spare[row, column], exact - keep)
    diagram = closer_than(a, b, margin_m)
    assert 100 < diagram.sum() < 1500
    assert spare[~diagram].min() >= 0
    assert spare[diagram].max() <= FORBID_TOLERANCE * margin_m + 2 * SLACK_M
    assert np.mean(spare[diagram] > 2 * SLACK_M) < 0.01


@pytest.mark.slow
def test_no_collision_is_missed_near_contact():
    """States close to first contact, on both sides of it, found by bisection."""
    rng = np.random.default_rng(5)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    met = 0
    while met < 60:
        here, there = random_qpos(rng, 2)
        a = planning_scene.arm(1, here)
        if (
            brute(a, planning_scene.arm(2, there), 0, 0) >= 0
            or brute(a, planning_scene.arm(2, REST), 0, 0) <= 0
        ):
            continue
        low, high = 0.0, 1.0  # the way of agent 2 back to rest: overlap at low, clear at high
        for _ in range(14):
            middle = (low + high) / 2
            hit = brute(a, planning_scene.arm(2, there + middle * (REST - there)), 0, 0) < 0
            low, high = (middle, high) if hit else (low, middle)
        for fraction in (low, high):
            b = planning_scene.arm(2, there + fraction * (REST - there))
            exact = brute(a, b, 0, 0)
            assert abs(exact) < 1e-3
            if exact < 0 or exact > 2 * SLACK_M:  # doubt counts as contact
                assert closer_than(a, b, 0.0)[0, 0] == (exact < 0)
            assert closer_than(a, b, 0.01)[0, 0]
        met += 1


def test_swapping_the_agents_transposes_the_diagram():
    a, b = arms(TWO, np.random.default_rng(6), 20)
    for between in (False, True):
        assert (closer_than(a, b, 0.01, between=between) == closer_than(b, a, 0.01, between=between).T).all()


def test_free_neighbours_prove_the_motion_between_them():
    """Half-way and quarter-way states between any two free neighbours keep clear of contact."""
    rng = np.random.default_rng(7)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    fine = 8
    keys = [random_qpos(rng, 4) for _ in range(2)]
    paths = [
        np.stack([np.interp(np.linspace(0, 3, 30 * fine + 1), range(4), key[:, k]) for k in range(7)], axis=1)
        for key in keys
    ]
    coarse = [path[::fine] for path in paths]
    free = ~closer_than(planning_scene.arm(1, coarse[0]), planning_scene.arm(2, coarse[1]), 0.0)
    hit = closer_than(planning_scene.arm(1, paths[0]), planning_scene.arm(2, paths[1]), 0.0, between=False)
    assert hit.any() and free.any()
    rows, columns = np.nonzero(free[:-1, :-1] & free[1:, 1:])
    for step in range(fine + 1):
        assert not hit[rows * fine + step, columns * fine + step].any()


def test_nearest_is_the_least_over_cells_and_pieces():
    a, b = arms(TWO, np.random.default_rng(8), 6)
    exact = np.array([[brute(a, b, r, c) for c in range(6)] for r in range(6)])
    found = nearest(a, b)
    assert found is not None
    assert found.distance_m == pytest.approx(exact.min(), abs=1e-6)
    assert exact[found.at] == pytest.approx(exact.min(), abs=1e-6)
    one = nearest(a, b, np.array([[2, 3]]))
    assert one is not None
    assert one.distance_m == pytest.approx(exact[2, 3], abs=1e-6)


def test_nearest_along_smooth_paths_looks_at_few_cells_and_misses_none(monkeypatch: pytest.MonkeyPatch):
    looked = []
    exactly = clearance.exact_m
    monkeypatch.setattr(clearance, "exact_m", lambda *where: looked.append(where) or exactly(*where))
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    rng, cells = np.random.default_rng(6), np.stack([np.arange(80)] * 2, axis=1)
    for _ in range(6):
        keys = [random_qpos(rng, 3) for _ in range(2)]
        paths = [
            np.stack([np.interp(np.linspace(0, 2, 80), range(3), k) for k in key.T[:7]]).T for key in keys
        ]
        a, b = planning_scene.arm(1, paths[0]), planning_scene.arm(2, paths[1])
        found, exact = nearest(a, b, cells), [brute(a, b, k, k) for k in range(80)]
        assert found is not None and found.distance_m == pytest.approx(min(exact), abs=1e-6)
        assert exact[found.at[0]] == pytest.approx(min(exact), abs=1e-6) and found.at[0] == found.at[1]
    assert len(looked) < 0.01 * 6 * 80 * len(a.pieces) * len(b.pieces)


def test_overlap_answers_for_touching_bodies_only():
    rng = np.random.default_rng(9)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    outcomes = set()
    for _ in range(40):
        a, b = planning_scene.arm(1, random_qpos(rng, 1)), planning_scene.arm(2, random_qpos(rng, 1))
        exact, found = brute(a, b, 0, 0), overlap(a, b)
        outcomes.add(found is None)
        assert (found is None) == (exact > 0)
        if found is not None:
            assert found.distance_m == pytest.approx(exact, abs=1e-6)
    assert outcomes == {True, False}


def test_contact_begins_at_distance_zero():
    def box(x_m: float) -> Swept:
        piece = Piece.of(trimesh.creation.box((0.1, 0.1, 0.1)))
        return Swept((piece,), ("box",), transform((x_m, 0, 0)).reshape(1, 1, 4, 4))

    touching = overlap(box(0.0), box(0.1))
    assert touching is not None and touching.distance_m == 0.0
    assert overlap(box(0.0), box(0.101)) is None


@pytest.mark.slow
def test_false_alarms_of_the_planning_margin_are_rare():
    """The margin may refuse states that do not touch: at most 5 % of them."""
    rng = np.random.default_rng(10)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    a, b = planning_scene.arm(1, random_qpos(rng, 60)), planning_scene.arm(2, random_qpos(rng, 60))
    alarm, touch = closer_than(a, b, 0.01, between=False), closer_than(a, b, 0.0, between=False)
    assert not (touch & ~alarm).any()
    assert (alarm & ~touch).sum() <= 0.05 * (~touch).sum()


def test_an_arm_that_folds_into_itself_is_found():
    folded_up = np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.0, 0.0])  # the hand inside the shoulder
    body = PlanningScene(TWO, scene_of(TWO)).arm(1, np.stack([REST, folded_up]))
    assert self_collisions(body, DEFAULT.self_pairs).tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [(40, 5), (3, 35), (1, 9), (1, 1)])
def test_paths_of_any_two_lengths_give_the_same_cells_as_long_ones(lengths):
    a, b = arms(TWO, np.random.default_rng(12), 40)
    whole = closer_than(a, b, 0.01, between=False)
    assert whole[: lengths[0], : lengths[1]].any() or min(lengths) == 1
    rows, columns = lengths
    a, b = replace(a, poses=a.poses[:rows]), replace(b, poses=b.poses[:columns])
    assert (closer_than(a, b, 0.01, between=False) == whole[:rows, :columns]).all()
