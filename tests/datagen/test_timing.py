"""Time parameterisation: motion keeps the joint limits, is rest to rest, and ends exactly at its goal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_exp.datagen.motion.branches import Approaches
from rf_exp.datagen.motion.timing import blend, densify, duration_s, parameterise
from rf_exp.errors import ArgumentError
from rf_exp.robots import DEFAULT
from rf_exp.tasks import default_of
from rf_exp.transforms import transform
from rf_exp.types import CONTROL_DT_S, JointLimits

LIMITS = JointLimits(**default_of("limits"))


def derivatives(start, timed):
    """Velocity and acceleration of the 20 Hz samples, at rest before and after."""
    full = np.concatenate([[start, start], timed, timed[-1:]])
    velocity = np.diff(full, axis=0) * 20
    return velocity, np.diff(velocity, axis=0) * 20


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 4))
def test_timed_motion_keeps_the_limits(seed, corners):
    rng = np.random.default_rng(seed)
    via = np.cumsum(rng.uniform(-0.5, 0.5, (corners, 7)), axis=0)
    points = blend(densify(via), 0.15)
    timed = parameterise(points, LIMITS)
    velocity, acceleration = derivatives(points[0], timed)
    assert np.abs(velocity).max() <= LIMITS.velocity_rad_s * 1.01
    assert np.abs(acceleration).max() <= LIMITS.acceleration_rad_s2 * 1.01
    np.testing.assert_allclose(timed[-1], via[-1], atol=1e-9)


def test_straight_line_takes_the_shortest_time():
    timed = parameterise(np.array([[0.0] * 7, [0.6] * 7]), LIMITS)
    assert len(timed) == np.ceil(2 * np.sqrt(0.6 / 0.9) * 20)  # does not reach the velocity limit


@pytest.mark.slow
def test_durations_of_approaches_are_estimated_without_bias(lift_barrier):
    arm, rng = lift_barrier.arms[1], np.random.default_rng(0)
    errors_s = []
    for _ in range(20):
        goals = np.stack([arm.tcp(np.array(DEFAULT.rest_rad) + rng.uniform(-0.4, 0.4, 7))])
        start = np.array(DEFAULT.rest_rad) + rng.uniform(-0.4, 0.4, 7)
        approaches = Approaches(arm, LIMITS, goals @ transform((0.0, 0.0, -0.1)), goals, start[None])
        for exact in filter(None, map(approaches.exact, approaches.estimated())):
            corners = densify(np.concatenate([start[None], exact.points]))
            errors_s.append(exact.duration_s - len(parameterise(blend(corners, 0.15), LIMITS)) * CONTROL_DT_S)
    assert len(errors_s) > 40
    assert abs(np.median(errors_s)) < 0.05 and np.percentile(np.abs(errors_s), 80) < 0.2


def test_the_duration_of_straight_motion_is_exact_and_a_corner_takes_longer():
    origin = np.zeros(7)
    far, farther = origin + 0.6, origin + 1.2
    assert duration_s(np.stack([origin, far]), LIMITS) == pytest.approx(2 * np.sqrt(0.6 / 0.9))
    straight, back = (duration_s(np.stack([origin, far, end]), LIMITS) for end in (farther, origin))
    assert straight == pytest.approx(duration_s(np.stack([origin, farther]), LIMITS))
    assert straight < back < 2 * duration_s(np.stack([origin, far]), LIMITS)


def test_a_path_without_motion_takes_no_time_and_a_nan_path_takes_forever():
    assert parameterise(np.zeros((5, 7)), LIMITS).shape == (0, 7)
    assert duration_s(np.zeros((3, 7)), LIMITS) == 0
    assert duration_s(np.full((2, 3, 7), np.nan), LIMITS).tolist() == [np.inf, np.inf]


@pytest.mark.parametrize("length_rad", [2e-9, 5e-9, 1e-8, 1e-6])
def test_a_path_of_rounding_errors_takes_one_control_step(length_rad: float):
    ends = np.array([[0.3] * 7, [0.3] * 6 + [0.3 + length_rad]])
    np.testing.assert_array_equal(parameterise(ends, LIMITS), ends[1:])


def test_blend_keeps_ends_and_straight_lines():
    line = densify(np.array([[0.0] * 7, [1.0] * 7]))
    np.testing.assert_allclose(blend(line, 0.2), line, atol=1e-9)
    corner = densify(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]))
    rounded = blend(corner, 0.15)
    np.testing.assert_array_equal(rounded[[0, -1]], corner[[0, -1]])
    assert 0.02 < np.linalg.norm(rounded - [1.0, 0.0], axis=1).min() < 0.2


def test_limits_must_be_positive():
    with pytest.raises(ArgumentError, match="velocity_rad_s is -1"):
        JointLimits(-1, 0.9)
