"""Success criteria on constructed scenes: successes and near misses."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.tasks import SuccessEvaluator
from rf_exp.tasks.predicates import once
from rf_exp.transforms import planar
from tests.scenes import start_scene


def judged(task, start, scene, steps):
    """The last of `steps` verdicts on a constant scene."""
    judge = SuccessEvaluator(task, start)
    return [judge(replace(scene, step=step)) for step in range(steps)][-1]


@pytest.fixture
def lifted(lift_barrier):
    """Start scene, and one with the barrier held level by both arms at a sufficient height."""
    start = start_scene(lift_barrier, 0)
    pose = start.poses["barrier"].copy()
    pose[2, 3] += 0.17
    return start, replace(start, poses={"barrier": pose}, held=("barrier", "barrier"))


def test_a_barrier_held_level_succeeds_after_the_hold_steps(lift_barrier, lifted):
    start, scene = lifted
    hold = int(lift_barrier.success["hold_steps"])
    assert not judged(lift_barrier, start, scene, hold - 1).success
    assert judged(lift_barrier, start, scene, hold).success
    assert judged(lift_barrier, start, scene, 1).success_paper


@pytest.mark.parametrize(
    ("change", "missing"),
    [
        (lambda s: replace(s, held=("barrier", None)), "held by both arms"),
        (lambda s: replace(s, held=(None, None)), "held by both arms"),
        (lambda s: replace(s, speeds={"barrier": 1.0}), "at rest"),  # thrown
        (lambda s: replace(s, poses={"barrier": s.poses["barrier"] @ tilt(8)}), "level"),
        (lambda s: replace(s, poses={"barrier": s.poses["barrier"] - drop(0.05)}), "lifted"),
    ],
)
def test_a_barrier_that_is_not_held_level_does_not_succeed(lift_barrier, lifted, change, missing):
    start, scene = lifted
    verdict = judged(lift_barrier, start, change(scene), 20)
    assert not verdict.success
    assert [name for name, holds in verdict.evidence.items() if not holds] == [missing]


def tilt(angle_deg):
    turn = np.eye(4)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = c, s, -s, c
    return turn


def drop(height_m):
    change = np.zeros((4, 4))
    change[2, 3] = height_m
    return change


def test_an_interrupted_hold_starts_again(lift_barrier, lifted):
    start, scene = lifted
    judge, hold = SuccessEvaluator(lift_barrier, start), int(lift_barrier.success["hold_steps"])
    for _ in range(hold - 1):
        assert not judge(scene).success
    judge(replace(scene, held=("barrier", None)))
    assert not judge(scene).success


@pytest.fixture
def food_in_pot(place_food):
    """Start scene, and one with the steak in the pot and the lid beside it."""
    start = start_scene(place_food, 0)
    x_m, y_m = start.poses["pot"][:2, 3]
    poses = {**start.poses, "steak": planar(x_m + 0.01, y_m, 0.3, 0.012), "lid": planar(x_m, y_m + 0.27, 0.0)}
    return start, replace(start, poses=poses)


def test_food_in_the_pot_and_lid_aside_succeeds(place_food, food_in_pot):
    start, scene = food_in_pot
    verdict = judged(place_food, start, scene, 20)
    assert verdict.success and verdict.success_paper


@pytest.mark.parametrize(
    ("change", "missing"),
    [
        (lambda s: replace(s, poses={**s.poses, "lid": s.poses["pot"] @ planar(0, 0, 0, 0.088)}), "lid off"),
        (lambda s: replace(s, held=("steak", None)), "released"),
        (lambda s: replace(s, held=(None, "lid")), "released"),
        (
            lambda s: replace(s, poses={**s.poses, "steak": s.poses["pot"] @ planar(0.0, -0.07, 0, 0.012)}),
            "steak inside the pot",
        ),
        (
            lambda s: replace(s, poses={**s.poses, "steak": s.poses["steak"] + drop(0.2)}),
            "steak inside the pot",
        ),
        (lambda s: replace(s, poses={**s.poses, "pot": s.poses["pot"] @ tilt(20)}), "pot upright"),
        (lambda s: replace(s, speeds={**s.speeds, "steak": 0.3}), "at rest"),
    ],
)
def test_food_that_is_only_nearly_in_place_does_not_succeed(place_food, food_in_pot, change, missing):
    start, scene = food_in_pot
    verdict = judged(place_food, start, change(scene), 20)
    assert not verdict.success
    assert missing in [name for name, holds in verdict.evidence.items() if not holds]


def test_the_papers_criterion_ignores_the_lid(place_food, food_in_pot):
    start, scene = food_in_pot
    on_pot = {**scene.poses, "lid": scene.poses["pot"] @ planar(0, 0, 0, 0.088)}
    assert judged(place_food, start, replace(scene, poses=on_pot), 1).success_paper


def test_nothing_is_left_to_do_after_success(lift_barrier, lifted, place_food, food_in_pot):
    for task, (_, scene) in ((lift_barrier, lifted), (place_food, food_in_pot)):
        assert task.module.plan(scene, task).subgoals == ()


@pytest.mark.parametrize(
    ("steps", "lost"),
    [
        ([("barrier", 0.2), (None, 0.19), (None, 0.16)], {}),  # set down
        ([("barrier", 0.2), (None, 0.14)], {"barrier": "dropped"}),
        ([("barrier", 0.2), (None, 0.14), ("barrier", 0.1)], {}),  # caught again
        ([(None, 0.2), (None, 0.1)], {}),  # never held
        ([("barrier", 0.2), (None, -0.1)], {"barrier": "off the table"}),
    ],
)
def test_an_object_that_falls_is_lost(lift_barrier, steps, lost):
    start = start_scene(lift_barrier, 0)
    judge, verdict = SuccessEvaluator(lift_barrier, start), None
    for holder, height_m in steps:
        pose = start.poses["barrier"].copy()
        pose[2, 3] = height_m
        verdict = judge(replace(start, poses={"barrier": pose}, held=(holder, None)))
    assert verdict is not None and verdict.lost == lost


def test_an_object_out_of_reach_of_all_arms_is_lost(lift_barrier):
    start = start_scene(lift_barrier, 0)
    for x_m, lost in ((0.3, {}), (0.9, {"barrier": "out of reach"})):
        moved = replace(start, poses={"barrier": planar(x_m, 0.0, 0.0)})
        assert SuccessEvaluator(lift_barrier, start)(moved).lost == lost


def test_conditions_with_a_number_report_value_and_bound(place_food, food_in_pot):
    start, scene = food_in_pot
    beside = replace(scene, poses={**scene.poses, "steak": planar(0.4, 0.0, 0.0, 0.012)})
    verdict = judged(place_food, start, beside, 1)
    inside = verdict.measured["steak inside the pot"]
    assert not inside and verdict.evidence["steak inside the pot"] is False
    assert inside.value == pytest.approx(np.hypot(*(np.array([0.4, 0.0]) - start.poses["pot"][:2, 3])))
    assert (inside.bound, inside.unit, inside.requirement) == (place_food.success["inside_m"], "m", "< 0.055")
    assert "released" not in verdict.measured  # conditions without a number


def test_shared_measurements_are_made_once_per_scene(lift_barrier):
    calls = []
    measure = once(lambda scene, task: calls.append(scene) or len(calls))
    first, second = start_scene(lift_barrier, 0), start_scene(lift_barrier, 1)
    assert [measure(scene, lift_barrier) for scene in (first, first, second, second, first)] == [
        1,
        1,
        2,
        2,
        3,
    ]
    assert measure(first, replace(lift_barrier)) == 4  # another task object, though equal
