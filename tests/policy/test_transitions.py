"""Transition integrator: an agent in an unchanged scene goes on in the end, at a likely subgoal."""

import numpy as np
import pytest

from rf_exp.policy.acting.diffusion_runner import TransitionIntegrator


def predicted(go: float, *subgoals: float) -> np.ndarray:
    return np.array([[*subgoals, go]])


def steps_until_free(bound: float, probabilities: np.ndarray, most: int = 50) -> int | None:
    transitions = TransitionIntegrator(bound)
    return next((count for count in range(1, most) if transitions(probabilities)[1][0]), None)


@pytest.mark.parametrize("go", [0.05, 0.2, 0.4, 0.5])
def test_predictions_of_an_unchanged_scene_add_up(go: float) -> None:
    assert steps_until_free(1.0, predicted(go, 0.9, 0.1)) == round(1 / go + 0.49)
    assert steps_until_free(0.0, predicted(go, 0.9, 0.1)) is None


def test_a_probability_above_half_goes_on_at_once() -> None:
    assert (
        steps_until_free(1.0, predicted(0.51, 1.0, 0.0))
        == steps_until_free(0.0, predicted(0.51, 1.0, 0.0))
        == 1
    )


def test_a_change_resets_the_sum() -> None:
    transitions = TransitionIntegrator(1.0)
    for count in range(20):
        assert not transitions(predicted(0.4, *((0.9, 0.1) if count % 2 else (0.8, 0.2))))[1].any()
    transitions(predicted(0.4, 0.9, 0.1))
    assert transitions(predicted(0.42, 0.9, 0.1))[1].all()


def test_each_agent_has_its_own_sum() -> None:
    transitions = TransitionIntegrator(1.0)
    probabilities = np.array([[1.0, 0.0, 0.4], [1.0, 0.0, 0.3]])
    assert [transitions(probabilities)[1].tolist() for _ in range(4)] == [
        [False, False],
        [False, False],
        [True, False],
        [True, True],
    ]


def test_where_no_subgoal_has_half_of_the_sum_it_goes_on_at_the_likeliest() -> None:
    transitions = TransitionIntegrator(1.0)
    probabilities = predicted(0.45, *[0.15] * 5, 0.25)
    found = [transitions(probabilities) for _ in range(3)]
    assert [(int(numbers[0]), bool(free[0])) for numbers, free in found] == [
        (5, False),
        (5, False),
        (5, True),
    ]


@pytest.mark.parametrize(("ahead", "number"), [(0.21, 1), (0.19, 0)])
def test_it_goes_on_at_the_later_subgoal_if_half_of_its_chances_are_there(ahead: float, number: int) -> None:
    transitions = TransitionIntegrator(1.0)
    probabilities = predicted(0.4, 1 - ahead, ahead)
    assert [transitions(probabilities)[0][0] for _ in range(3)] == [0, 0, number]
