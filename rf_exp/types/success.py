"""How far a task is done."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Measured(NamedTuple):  # a frozen dataclass takes three times as long, many times a control step
    """A number against its bound; as a condition of success it is as true as `holds`."""

    holds: bool
    value: float
    bound: float
    unit: str
    above: bool  # the value should be above the bound, otherwise below it

    def __bool__(self) -> bool:
        return self.holds

    @property
    def asked(self) -> str:
        return f"{'>' if self.above else '<'} {self.bound:g}"


Condition = bool | Measured  # of success
UNITS = ("", "m", "m/s", "deg", "rad", "s", "N", "kg")  # that a `Measured` may have


class Verdict(NamedTuple):  # as above
    """What the success criteria say about one step."""

    success: bool  # strict, held long enough
    success_paper: bool
    evidence: Mapping[str, bool]  # named condition -> holds now
    measured: Mapping[str, Measured] = MappingProxyType({})  # the numbers of those that have one
    lost: Mapping[str, str] = MappingProxyType({})  # object -> dropped | out of reach | off the table


@dataclass(frozen=True)
class Judged:
    """How far each of C conditions of success was met. Row t is what action t has led to."""

    names: tuple[str, ...]
    value: NDArray[np.float32]  # (T, C) 1 or 0 where a condition is a mere yes or no
    bound: NDArray[np.float32]  # (T, C) against which the value is held
    unit: NDArray[np.uint8]  # (T, C) of both, an index of UNITS: a condition may have several sides
    holds: NDArray[np.bool_]  # (T, C)
