"""Confidence intervals of figures in the tables: rates, differences of rates, means.

Small samples are the rule here (20 scenes, 100 scenes), so proportions use Wilson's score interval
and Newcombe's method 10 for differences, which stay inside [0, 1] and keep their coverage near the
ends: R. G. Newcombe, Statistics in Medicine 17 (1998), pp. 857-872, 873-890 and, of pairs, 2635-2650.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from statistics import fmean, stdev

from scipy.stats import binomtest, t

from rf_exp.errors import ArgumentError

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A value with its confidence interval. Rates are fractions in [0, 1]."""

    value: float
    low: float
    high: float
    n: int

    @property
    def interval(self) -> tuple[float, float]:
        return self.low, self.high


def wilson(successes: int, n: int, confidence: float = CONFIDENCE) -> Estimate:
    """The rate `successes / n` with Wilson's score interval, without continuity correction.

    Raises ArgumentError unless 0 <= successes <= n and n > 0, and for a confidence that is no fraction.
    """
    if not 0 < confidence < 1:
        raise ArgumentError(f"confidence {confidence}; expected a number between 0 and 1, e.g. 0.95")
    if n <= 0 or not 0 <= successes <= n:
        raise ArgumentError(
            f"rate of {successes} successes in {n} trials; expected 0 <= successes <= n and n > 0"
        )
    interval = binomtest(successes, n).proportion_ci(confidence, method="wilson")
    # Exact at the ends, where rounding could leave 1e-17.
    low = 0.0 if successes == 0 else float(interval.low)
    high = 1.0 if successes == n else float(interval.high)
    return Estimate(successes / n, low, high, n)


def difference(a: Estimate, b: Estimate) -> Estimate:
    """The difference of two independent rates `a - b` with Newcombe's hybrid score interval.

    Both come from `wilson`; `n` of the result is the smaller sample.
    """
    gap = a.value - b.value
    low = gap - sqrt((a.value - a.low) ** 2 + (b.high - b.value) ** 2)
    high = gap + sqrt((a.high - a.value) ** 2 + (b.value - b.low) ** 2)
    return Estimate(gap, low, high, min(a.n, b.n))


@dataclass(frozen=True)
class Paired:
    """A difference of two rates over the same scenes, and the probability of one as large by chance."""

    estimate: Estimate  # `n` counts pairs
    p: float  # two-sided


def paired(pairs: Sequence[tuple[bool, bool]]) -> Paired:
    """The difference of the rates of first and second, where each pair is one scene, tried both ways.

    The interval is Newcombe's method 10 for pairs (Statistics in Medicine 17:2635-2650): Wilson's intervals
    of both rates, combined by their correlation. `p` is of McNemar's exact test: half of the pairs that
    differ are expected to differ either way. Raises ArgumentError without pairs.
    """
    if not pairs:
        raise ArgumentError("a paired difference without pairs; expected at least one scene tried both ways")
    n = len(pairs)
    both = sum(a and b for a, b in pairs)
    only_first, only_second = sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)
    first_rate, second_rate = wilson(both + only_first, n), wilson(both + only_second, n)
    correlation = _correlation(both, only_first, only_second, n - both - only_first - only_second)
    first_below, first_above = first_rate.value - first_rate.low, first_rate.high - first_rate.value
    second_below, second_above = second_rate.value - second_rate.low, second_rate.high - second_rate.value
    gap = (only_first - only_second) / n

    def hypotenuse(a: float, b: float) -> float:
        return sqrt(max(a * a - 2 * correlation * a * b + b * b, 0.0))

    low, high = gap - hypotenuse(first_below, second_above), gap + hypotenuse(first_above, second_below)
    differ = only_first + only_second
    p = float(binomtest(only_first, differ).pvalue) if differ else 1.0
    return Paired(Estimate(gap, low, high, n), p)


def _correlation(both: int, first: int, second: int, neither: int) -> float:
    """Phi coefficient of a 2 x 2 table, with the continuity correction of method 10; 0 where undefined."""
    product = (both + first) * (second + neither) * (both + second) * (first + neither)
    if not product:
        return 0.0
    excess = both * neither - first * second
    if excess > 0:
        excess = max(excess - (both + first + second + neither) / 2, 0.0)
    return excess / sqrt(product)


def mean(values: Sequence[float]) -> Estimate:
    """The mean of a sample with Student's t interval; a single value has the interval (-inf, inf).

    Raises ArgumentError for an empty sample.
    """
    if not values:
        raise ArgumentError("mean of an empty sample; expected at least one value")
    centre, n = fmean(values), len(values)
    if n == 1:
        return Estimate(centre, float("-inf"), float("inf"), 1)
    low, high = t.interval(CONFIDENCE, n - 1, loc=centre, scale=stdev(values) / sqrt(n))
    return Estimate(centre, float(low), float(high), n)
