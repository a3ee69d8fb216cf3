"""The units of quantities: how they are written, and what one of them is worth.

One table for constraints and subgoals: signs and words, both spellings, singular and plural.
"""

from collections.abc import Iterable, Mapping
from itertools import product
from math import pi
from typing import Literal

Quantity = Literal["m", "s", "deg", "speed"]
Worth = tuple[float, float]  # times, per: a number of a unit is that number * times / per of the base unit

_LENGTHS: Mapping[str, Worth] = {
    "m metre metres meter meters": (1, 1),
    "cm centimetre centimetres centimeter centimeters": (1, 100),
    "mm millimetre millimetres millimeter millimeters": (1, 1000),
}
_TIMES: Mapping[str, Worth] = {
    "s sec secs second seconds": (1, 1),
    "ms millisecond milliseconds": (1, 1000),
    "min mins minute minutes": (60, 1),
}
_ANGLES: Mapping[str, Worth] = {"deg degree degrees \u00b0": (1, 1), "rad radian radians": (180, pi)}


def _listed(table: Mapping[str, Worth]) -> dict[str, Worth]:
    return {unit: worth for units, worth in table.items() for unit in units.split()}


UNITS: Mapping[Quantity, Mapping[str, Worth]] = {
    "m": _listed(_LENGTHS),
    "s": _listed(_TIMES),
    "deg": _listed(_ANGLES),
    "speed": {
        f"{unit}{per}{second}": worth
        for (unit, worth), per, second in product(
            _listed(_LENGTHS).items(), ("/", " / ", " per "), ("s", "sec", "second")
        )
    },
}
BASE: Mapping[Quantity, str] = {"m": "m", "s": "s", "deg": "deg", "speed": "m/s"}


def pattern(units: Iterable[str]) -> str:
    """A regular expression of these units, in lower case, the longest first."""
    return "|".join(sorted(units, key=lambda unit: (-len(unit), unit)))


def value(quantity: Quantity, number: str, unit: str) -> float:
    """A number of a unit in m, s, deg or m/s."""
    times, per = UNITS[quantity][unit]
    return (float(number) + 0.0) * times / per
