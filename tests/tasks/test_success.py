"""Success criteria, on scenes made by hand: what counts, and what only looks like it."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.tasks import SuccessEvaluator
from rf_exp.tasks.predicates import once
from rf_exp.transforms import planar
from tests.scenes import start_scene


def judged(task, start, scene, steps):
    """The last of `steps` verdicts on a scene that stays as it is."""
    judge = SuccessEvaluator(task, start)
    return [judge(replace(scene, step=step)) for step in range(steps)][-1]


@pytest.fixture
def lifted(lift_barrier):
    """Start, and the barrier held level by both arms, high enough."""
    start = start_scene(lift_barrier, 0)
    pose = start.poses["barrier"].copy()
    pose[2, 3] += 0.17
    return start, replace(start, poses={"barrier": pose}, held=("barrier", "barrier"))


def test_a_barrier_held_level_succeeds_after_the_steps_it_must_be_held(lift_barrier, lifted):
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
        (lambda s: replace(s, speeds={"barrier": 1.0}), "at rest"),  # flung
        (lambda s: replace(s, poses={"barrier": s.poses["barrier"] @ tilt(8)}), "level"),
        (lambda s: replace(s, poses={"barrier": s.poses["barrier"] - drop(0.05)}), "lifted"),
    ],
)
def test_a_barrier_that_is_up_somehow_does_not(lift_barrier, lifted, change, missing):
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


def test_an_interrupted_hold_begins_anew(lift_barrier, lifted):
    start, scene = lifted
    judge, hold = SuccessEvaluator(lift_barrier, start), int(lift_barrier.success["hold_steps"])
    for _ in range(hold - 1):
        assert not judge(scene).success
    judge(replace(scene, held=("barrier", None)))
    assert not judge(scene).success


@pytest.fixture
def cooked(place_food):
    """Start, and the steak in the pot with the lid beside it."""
    start = start_scene(place_food, 0)
    x_m, y_m = start.poses["pot"][:2, 3]
    poses = {**start.poses, "steak": planar(x_m + 0.01, y_m, 0.3, 0.012), "lid": planar(x_m, y_m + 0.27, 0.0)}
    return start, replace(start, poses=poses)


def test_food_in_the_pot_and_lid_aside_succeeds(place_food, cooked):
    start, scene = cooked
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
def test_food_that_is_only_nearly_cooked_does_not(place_food, cooked, change, missing):
    start, scene = cooked
    verdict = judged(place_food, start, change(scene), 20)
    assert not verdict.success
    assert missing in [name for name, holds in verdict.evidence.items() if not holds]


def test_the_papers_criterion_does_not_see_the_lid(place_food, cooked):
    start, scene = cooked
    on_pot = {**scene.poses, "lid": scene.poses["pot"] @ planar(0, 0, 0, 0.088)}
    assert judged(place_food, start, replace(scene, poses=on_pot), 1).success_paper


def test_nothing_is_left_to_do_after_success(lift_barrier, lifted, place_food, cooked):
    for task, (_, scene) in ((lift_barrier, lifted), (place_food, cooked)):
        assert task.module.plan(scene, task).subgoals == ()


@pytest.mark.parametrize(
    ("steps", "lost"),
    [
        ([("barrier", 0.2), (None, 0.19), (None, 0.16)], {}),  # set down
        ([("barrier", 0.2), (None, 0.14)], {"barrier": "dropped"}),
        ([("barrier", 0.2), (None, 0.14), ("barrier", 0.1)], {}),  # and caught again
        ([(None, 0.2), (None, 0.1)], {}),  # nobody had it
        ([("barrier", 0.2), (None, -0.1)], {"barrier": "off the table"}),
    ],
)
def test_a_thing_that_falls_is_lost(lift_barrier, steps, lost):
    start = start_scene(lift_barrier, 0)
    judge, verdict = SuccessEvaluator(lift_barrier, start), None
    for holder, height_m in steps:
        pose = start.poses["barrier"].copy()
        pose[2, 3] = height_m
        verdict = judge(replace(start, poses={"barrier": pose}, held=(holder, None)))
    assert verdict is not None and verdict.lost == lost


def test_what_no_arm_reaches_any_more_is_lost(lift_barrier):
    start = start_scene(lift_barrier, 0)
    for x_m, lost in ((0.3, {}), (0.9, {"barrier": "out of reach"})):
        moved = replace(start, poses={"barrier": planar(x_m, 0.0, 0.0)})
        assert SuccessEvaluator(lift_barrier, start)(moved).lost == lost


def test_conditions_with_a_number_say_by_how_much(place_food, cooked):
    start, scene = cooked
    beside = replace(scene, poses={**scene.poses, "steak": planar(0.4, 0.0, 0.0, 0.012)})
    verdict = judged(place_food, start, beside, 1)
    inside = verdict.measured["steak inside the pot"]
    assert not inside and verdict.evidence["steak inside the pot"] is False
    assert inside.value == pytest.approx(np.hypot(*(np.array([0.4, 0.0]) - start.poses["pot"][:2, 3])))
    assert (inside.bound, inside.unit, inside.requirement) == (place_food.success["inside_m"], "m", "< 0.055")
    assert "released" not in verdict.measured  # a condition may be a bare yes or no


def test_what_conditions_share_is_measured_once_a_scene(lift_barrier):
    asked = []
    measure = once(lambda scene, task: asked.append(scene) or len(asked))
    first, second = start_scene(lift_barrier, 0), start_scene(lift_barrier, 1)
    assert [measure(scene, lift_barrier) for scene in (first, first, second, second, first)] == [
        1,
        1,
        2,
        2,
        3,
    ]
    assert measure(first, replace(lift_barrier)) == 4  # another task, though it is alike
