"""Intervals for what the tables report: rates, differences of rates, means.

Small samples are the rule here (20 scenes, 100 scenes), so proportions use Wilson's score interval
and Newcombe's method 10 for differences, which stay inside [0, 1] and keep their coverage near the
ends: R. G. Newcombe, Statistics in Medicine 17 (1998), pp. 857-872 and 873-890.
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

    Raises ArgumentError unless 0 <= successes <= n and n > 0.
    """
    if n <= 0 or not 0 <= successes <= n:
        raise ArgumentError(
            f"rate of {successes} successes in {n} trials; expected 0 <= successes <= n and n > 0"
        )
    found = binomtest(successes, n).proportion_ci(_checked(confidence), method="wilson")
    # Exact at the ends, where rounding could leave 1e-17.
    low = 0.0 if successes == 0 else float(found.low)
    high = 1.0 if successes == n else float(found.high)
    return Estimate(successes / n, low, high, n)


def difference(a: Estimate, b: Estimate) -> Estimate:
    """The difference of two independent rates `a - b` with Newcombe's hybrid score interval.

    Both come from `wilson` with the same confidence; `n` of the result is the smaller sample.
    """
    gap = a.value - b.value
    low = gap - sqrt((a.value - a.low) ** 2 + (b.high - b.value) ** 2)
    high = gap + sqrt((a.high - a.value) ** 2 + (b.value - b.low) ** 2)
    return Estimate(gap, low, high, min(a.n, b.n))


def mean(values: Sequence[float], confidence: float = CONFIDENCE) -> Estimate:
    """The mean of a sample with Student's t interval; a single value has the interval (-inf, inf).

    Raises ArgumentError for an empty sample.
    """
    if not values:
        raise ArgumentError("mean of an empty sample; expected at least one value")
    centre, n = fmean(values), len(values)
    if n == 1:
        return Estimate(centre, float("-inf"), float("inf"), 1)
    low, high = t.interval(_checked(confidence), n - 1, loc=centre, scale=stdev(values) / sqrt(n))
    return Estimate(centre, float(low), float(high), n)


def _checked(confidence: float) -> float:
    if not 0 < confidence < 1:
        raise ArgumentError(f"confidence {confidence}; expected a number between 0 and 1, e.g. 0.95")
    return confidence
