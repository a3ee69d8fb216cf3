"""Fields of a configuration that say what they may be, once, where they are declared.

A configuration may come with the policy of somebody else, so every number has its bounds: far above what is
of use, and below what would take all memory, or for ever.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from rf_exp.errors import ArgumentError, choices

ITEMS, WIDEST = 8, 8192  # of a list, such as the layers of a network; numbers in a layer
BOUNDS, ACTING = "bounds", "acting"  # what a field says of itself


@dataclass(frozen=True)
class Bounds:
    """What each number of a field has to be, and the words for it."""

    most: float = math.inf
    least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    expected: str = ""

    def check(self, name: str, value: object, one: float) -> None:
        """Raises ArgumentError for one number of a value that is out of bounds."""
        finite = isinstance(one, int) or math.isfinite(one)
        require(finite and one <= self.most, name, value, f"finite, and at most {self.most:g}")
        holds = self.least <= one and self.above < one < self.below
        expected = f"{self.least:g} or above" if self.least > -math.inf else f"a number above {self.above:g}"
        if self.below < math.inf:
            expected = f"a number in [{self.least:g}, {self.below:g})"
        require(holds, name, value, self.expected or expected)


def bounded(most: float = WIDEST, *, acting: bool = False, **limits: Any) -> Any:
    """A field of a number, or of several, as Bounds says; with `acting` it changes no weight."""
    return field(metadata={BOUNDS: Bounds(most, **limits), ACTING: acting})


def one_of(*possible: str, acting: bool = False) -> Any:
    """A field of one of these words."""
    return field(metadata={BOUNDS: possible, ACTING: acting})


def require(holds: bool, name: str, got: object, expected: str) -> None:
    """Raises ArgumentError that names a field, unless something holds."""
    if not holds:
        raise ArgumentError(f"{name} is {got!r}; expected {expected}")


class Checked:
    """Base of frozen dataclasses whose fields are bounded: each value is looked at."""

    def __post_init__(self) -> None:
        for each in fields(self):  # pyright: ignore[reportArgumentType]
            value, bounds = getattr(self, each.name), each.metadata.get(BOUNDS, Bounds())
            if isinstance(bounds, tuple):
                if value not in bounds:
                    raise choices(each.name, value, bounds)
                continue
            several = isinstance(value, tuple)
            for one in value if several else (value,):
                if isinstance(one, bool):
                    require(each.type is bool, each.name, value, "a number")
                elif isinstance(one, int | float):
                    bounds.check(each.name, value, one)
            require(not several or len(value) <= ITEMS, each.name, value, f"at most {ITEMS} of them")
        self.check()

    def check(self) -> None:
        """Raises ArgumentError for values that do not go together."""


def values(config: Any, acting: bool | None = None, within: bool = False) -> dict[str, Any]:
    """All fields, as mappings, those that decide `acting` alone, or the others; `within`: all of them do."""
    found: dict[str, Any] = {}
    for each in fields(config):
        value, acts = getattr(config, each.name), within or each.metadata.get(ACTING, False)
        if is_dataclass(value):
            inner = values(value, acting, acts)
            found |= {each.name: inner} if inner else {}
        elif acting is None or acts == acting:
            found[each.name] = value
    return found


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with the values of another one in it, which wins."""
    found = dict(one)
    for key, value in other.items():
        both = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = merged(found[key], value) if both else value
    return found
