"""Checks of a number that has a bound: the worst one planned, every one measured, and their form in STL."""

import operator
from collections.abc import Callable, Mapping
from typing import ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.stl import Comparison, Specification, bounded
from rf_exp.findings import About, Finding

_COMPARED: Mapping[Comparison, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    ">": operator.gt,
}


class BoundedCheck(Check):
    """A check of a number that keeps to one side of its bound, which is another one where it is measured."""

    finding: ClassVar[Finding]  # that it makes
    comparison: Comparison = "<="  # of the number with its bound
    bounds: tuple[float, float]  # of the number as planned, and as measured

    def worst(self, values: NDArray[np.float64]) -> int:
        """Where numbers (T,) come nearest to their bound, or are farthest beyond it; the first such place."""
        return int(values.argmax() if self.comparison == "<=" else values.argmin())

    def judged(self, value: float, time_s: float, **about: Unpack[About]) -> Evidence:
        """Evidence of one number, planned unless it is said to be measured."""
        bound = self.bounds[about.get("measured", False)]
        ok = bool(_COMPARED[self.comparison](value, bound))
        return self.found(ok, self.finding, float(value), bound, time_s, **about)

    def formula(self, name: str, how: str, when: tuple[str, str] = ("", "")) -> Specification:
        """Its form: a signal of what is measured, and `when` that speaks; each a name and its meaning."""
        return bounded(self, (name, how), self.comparison, self.bounds[True], when)
