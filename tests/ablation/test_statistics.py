"""Intervals against published values."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rf_exp.ablation import Estimate, difference, mean, paired, wilson
from rf_exp.errors import ArgumentError


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [  # Newcombe 1998, Statistics in Medicine 17:857, table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_gives_the_published_intervals(successes: int, n: int, low: float, high: float) -> None:
    estimate = wilson(successes, n)
    assert estimate.interval == pytest.approx((low, high), abs=5e-5)
    assert (estimate.value, estimate.n) == (successes / n, n)


@pytest.mark.parametrize(
    ("a", "b", "low", "high"),
    [  # Newcombe 1998, Statistics in Medicine 17:873, table II, method 10
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((6, 7), (2, 7), 0.0582, 0.8062),
        ((5, 56), (0, 29), -0.0381, 0.1926),
        ((0, 10), (0, 20), -0.1611, 0.2775),
        ((10, 10), (0, 20), 0.6791, 1.0000),
    ],
)
def test_difference_gives_the_published_intervals(
    a: tuple[int, int], b: tuple[int, int], low: float, high: float
) -> None:
    estimate = difference(wilson(*a), wilson(*b))
    assert estimate.value == pytest.approx(a[0] / a[1] - b[0] / b[1])
    assert estimate.interval == pytest.approx((low, high), abs=5e-5)


def pairs(both: int, first: int, second: int, neither: int) -> list[tuple[bool, bool]]:
    """The pairs of a two-by-two table."""
    one, other = [(True, False)] * first, [(False, True)] * second
    return [(True, True)] * both + one + other + [(False, False)] * neither


@pytest.mark.parametrize(
    ("table", "low", "high", "p"),
    [  # Fagerland, Lydersen, Laake 2014, Statistics in Medicine 33:2850: Newcombe, and McNemar's exact test
        ((1, 1, 7, 12), -0.507, -0.026, 0.0703),
        ((59, 6, 16, 80), -0.1186, -0.0046, 0.0525),
    ],
)
def test_paired_gives_the_published_interval_and_p(
    table: tuple[int, int, int, int], low: float, high: float, p: float
) -> None:
    found = paired(pairs(*table))
    assert found.estimate.value == pytest.approx((table[1] - table[2]) / sum(table))
    assert found.estimate.interval == pytest.approx((low, high), abs=5e-4)
    assert found.p == pytest.approx(p, abs=5e-5)


def test_pairs_that_all_agree_show_no_difference() -> None:
    for table in ((10, 0, 0, 0), (0, 0, 0, 10), (6, 0, 0, 4)):
        found = paired(pairs(*table))
        assert (found.estimate.value, found.p, found.estimate.n) == (0.0, 1.0, 10)
        assert found.estimate.low <= 0 <= found.estimate.high


@given(st.tuples(*[st.integers(0, 60)] * 4).filter(any))
def test_paired_intervals_hold_the_estimate_and_swap_with_the_sides(table: tuple[int, int, int, int]) -> None:
    one = paired(pairs(*table))
    other = paired([(b, a) for a, b in pairs(*table)])
    assert -1.0 - 1e-9 <= one.estimate.low <= one.estimate.value <= one.estimate.high <= 1.0 + 1e-9
    assert one.estimate.interval == pytest.approx((-other.estimate.high, -other.estimate.low))
    assert one.p == pytest.approx(other.p) and 0 < one.p <= 1


def test_a_paired_difference_needs_pairs() -> None:
    with pytest.raises(ArgumentError, match="expected at least one scene tried both ways"):
        paired([])


def test_mean_gives_students_own_interval() -> None:
    # Student 1908, additional hours of sleep, paired differences: the example of R's t.test.
    hours = [1.2, 2.4, 1.3, 1.3, 0.0, 1.0, 1.8, 0.8, 4.6, 1.4]
    estimate = mean(hours)
    assert estimate.value == pytest.approx(1.58)
    assert estimate.interval == pytest.approx((0.7001142, 2.4598858), abs=1e-6)


def test_one_value_has_an_unbounded_interval() -> None:
    assert mean([80.0]) == Estimate(80.0, float("-inf"), float("inf"), 1)


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_intervals_hold_the_estimate_within_0_and_1(case: tuple[int, int]) -> None:
    estimate = wilson(*case)
    assert 0.0 <= estimate.low <= estimate.value <= estimate.high <= 1.0
    mirrored = wilson(case[1] - case[0], case[1])
    assert (mirrored.low, mirrored.high) == pytest.approx((1 - estimate.high, 1 - estimate.low))


@pytest.mark.parametrize(("successes", "n"), [(1, 0), (3, 2), (-1, 5)])
def test_wilson_refuses_invalid_rates(successes: int, n: int) -> None:
    with pytest.raises(ArgumentError, match=rf"{successes} successes in {n} trials; expected 0 <= successes"):
        wilson(successes, n)


def test_mean_refuses_an_empty_sample() -> None:
    with pytest.raises(ArgumentError, match="empty sample; expected at least one value"):
        mean([])


def test_confidence_is_a_fraction() -> None:
    with pytest.raises(ArgumentError, match=r"confidence 95; expected a number between 0 and 1"):
        wilson(1, 2, confidence=95)
