"""Collision diagrams and distances against brute force with coal over all pairs of links."""

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


def exact_distance_m(a: Swept, b: Swept, row: int, column: int) -> float:
    """The exact distance of two bodies: the minimum over all pairs of pieces, in m."""
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
def test_the_diagram_equals_the_exact_test_of_every_cell(margin_m):
    a, b = arms(TWO, np.random.default_rng(3), 14)
    exact = np.array([[exact_distance_m(a, b, r, c) for c in range(14)] for r in range(14)])
    diagram = closer_than(a, b, margin_m, between=False)
    assert 5 < diagram.sum() < 190  # both outcomes occur
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
    edge = np.argwhere(diagram[1:, 1:] != diagram[:-1, 1:])[:60]  # cells at the boundary
    for row, column in np.concatenate([cells, edge]).tolist():
        exact = exact_distance_m(a, b, row, column)
        assert exact < (1 + FORBID_TOLERANCE) * 0.01 + 2 * SLACK_M if diagram[row, column] else exact >= 0.01


@pytest.mark.slow
def test_cells_are_forbidden_only_within_the_tolerance():
    """The clearance of free and forbidden cells of smooth paths lies on either side of the limit."""
    rng = np.random.default_rng(11)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    sweep = np.linspace(0, 1, 40)[:, None]
    keys = random_qpos(rng, 2), random_qpos(rng, 2)
    a, b = (planning_scene.arm(k + 1, key[0] + sweep * (key[1] - key[0])) for k, key in enumerate(keys))
    margin_m = 0.01
    clearance_m = np.full((40, 40), np.inf)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for row, column, i, j in np.ndindex(40, 40, len(a.pieces), len(b.pieces)):
        required_m = margin_m + (a.stride_m[row, i] + b.stride_m[column, j]) / 2
        gap_m = np.linalg.norm(a.centres[row, i] - b.centres[column, j]) - a.radii_m[i] - b.radii_m[j]
        if gap_m - required_m < min(clearance_m[row, column], margin_m):
            result.clear()
            transforms = a.coal_transform(row, i), b.coal_transform(column, j)
            exact = coal.distance(
                a.pieces[i].shape, transforms[0], b.pieces[j].shape, transforms[1], request, result
            )
            clearance_m[row, column] = min(clearance_m[row, column], exact - required_m)
    diagram = closer_than(a, b, margin_m)
    assert 100 < diagram.sum() < 1500
    assert clearance_m[~diagram].min() >= 0
    assert clearance_m[diagram].max() <= FORBID_TOLERANCE * margin_m + 2 * SLACK_M
    assert np.mean(clearance_m[diagram] > 2 * SLACK_M) < 0.01


@pytest.mark.slow
def test_no_collision_is_missed_near_contact():
    """For states on both sides of first contact, found by bisection."""
    rng = np.random.default_rng(5)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    contacts = 0
    while contacts < 60:
        qpos_a, qpos_b = random_qpos(rng, 2)
        a = planning_scene.arm(1, qpos_a)
        if (
            exact_distance_m(a, planning_scene.arm(2, qpos_b), 0, 0) >= 0
            or exact_distance_m(a, planning_scene.arm(2, REST), 0, 0) <= 0
        ):
            continue
        low, high = 0.0, 1.0  # motion of agent 2 back to rest: overlap at low, free at high
        for _ in range(14):
            middle = (low + high) / 2
            hit = exact_distance_m(a, planning_scene.arm(2, qpos_b + middle * (REST - qpos_b)), 0, 0) < 0
            low, high = (middle, high) if hit else (low, middle)
        for fraction in (low, high):
            b = planning_scene.arm(2, qpos_b + fraction * (REST - qpos_b))
            exact = exact_distance_m(a, b, 0, 0)
            assert abs(exact) < 1e-3
            if exact < 0 or exact > 2 * SLACK_M:  # distances within the tolerance count as contact
                assert closer_than(a, b, 0.0)[0, 0] == (exact < 0)
            assert closer_than(a, b, 0.01)[0, 0]
        contacts += 1


def test_swapping_the_agents_transposes_the_diagram():
    a, b = arms(TWO, np.random.default_rng(6), 20)
    for between in (False, True):
        assert (closer_than(a, b, 0.01, between=between) == closer_than(b, a, 0.01, between=between).T).all()


def test_motion_between_free_neighbours_is_free():
    """Intermediate states between any two free neighbours have no contact."""
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


def test_nearest_is_the_minimum_over_cells_and_pieces():
    a, b = arms(TWO, np.random.default_rng(8), 6)
    exact = np.array([[exact_distance_m(a, b, r, c) for c in range(6)] for r in range(6)])
    closest = nearest(a, b)
    assert closest is not None
    assert closest.distance_m == pytest.approx(exact.min(), abs=1e-6)
    assert exact[closest.at] == pytest.approx(exact.min(), abs=1e-6)
    in_cell = nearest(a, b, np.array([[2, 3]]))
    assert in_cell is not None
    assert in_cell.distance_m == pytest.approx(exact[2, 3], abs=1e-6)


def test_nearest_along_smooth_paths_evaluates_few_cells_exactly(monkeypatch: pytest.MonkeyPatch):
    evaluated = []
    exact_m = clearance.exact_m
    monkeypatch.setattr(
        clearance, "exact_m", lambda *arguments: evaluated.append(arguments) or exact_m(*arguments)
    )
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    rng, cells = np.random.default_rng(6), np.stack([np.arange(80)] * 2, axis=1)
    for _ in range(6):
        keys = [random_qpos(rng, 3) for _ in range(2)]
        paths = [
            np.stack([np.interp(np.linspace(0, 2, 80), range(3), k) for k in key.T[:7]]).T for key in keys
        ]
        a, b = planning_scene.arm(1, paths[0]), planning_scene.arm(2, paths[1])
        closest, exact = nearest(a, b, cells), [exact_distance_m(a, b, k, k) for k in range(80)]
        assert closest is not None and closest.distance_m == pytest.approx(min(exact), abs=1e-6)
        assert exact[closest.at[0]] == pytest.approx(min(exact), abs=1e-6) and closest.at[0] == closest.at[1]
    assert len(evaluated) < 0.01 * 6 * 80 * len(a.pieces) * len(b.pieces)


def test_overlap_is_found_for_touching_bodies_only():
    rng = np.random.default_rng(9)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    outcomes = set()
    for _ in range(40):
        a, b = planning_scene.arm(1, random_qpos(rng, 1)), planning_scene.arm(2, random_qpos(rng, 1))
        exact, contact = exact_distance_m(a, b, 0, 0), overlap(a, b)
        outcomes.add(contact is None)
        assert (contact is None) == (exact > 0)
        if contact is not None:
            assert contact.distance_m == pytest.approx(exact, abs=1e-6)
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
    """The margin refuses at most 5 % of the states without contact."""
    rng = np.random.default_rng(10)
    planning_scene = PlanningScene(TWO, scene_of(TWO))
    a, b = planning_scene.arm(1, random_qpos(rng, 60)), planning_scene.arm(2, random_qpos(rng, 60))
    alarm, touch = closer_than(a, b, 0.01, between=False), closer_than(a, b, 0.0, between=False)
    assert not (touch & ~alarm).any()
    assert (alarm & ~touch).sum() <= 0.05 * (~touch).sum()


def test_a_self_collision_is_found():
    folded_up = np.array([0.0, -1.7, 0.0, -3.0, 0.0, 0.0, 0.0])  # the gripper inside the shoulder
    body = PlanningScene(TWO, scene_of(TWO)).arm(1, np.stack([REST, folded_up]))
    assert self_collisions(body, DEFAULT.self_pairs).tolist() == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("lengths", [(40, 5), (3, 35), (1, 9), (1, 1)])
def test_diagrams_of_shorter_paths_equal_parts_of_the_full_one(lengths):
    a, b = arms(TWO, np.random.default_rng(12), 40)
    full = closer_than(a, b, 0.01, between=False)
    assert full[: lengths[0], : lengths[1]].any() or min(lengths) == 1
    rows, columns = lengths
    a, b = replace(a, poses=a.poses[:rows]), replace(b, poses=b.poses[:columns])
    assert (closer_than(a, b, 0.01, between=False) == full[:rows, :columns]).all()
