"""Bounds of configuration fields, declared with each field and checked on construction.

A configuration may come with a policy from someone else, so every number is bounded: far above useful values,
and below those that would exhaust memory or run forever.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from rf_exp.errors import ArgumentError, choices

ITEMS, WIDEST = 8, 8192  # most items of a list, such as layers of a network; widest layer
BOUNDS, ACTING = "bounds", "acting"  # keys of the metadata of a field


@dataclass(frozen=True)
class Bounds:
    """Limits of the numbers of a field, and their wording in errors."""

    most: float = math.inf
    least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    expected: str = ""

    def check(self, name: str, value: object, one: float) -> None:
        """Raises ArgumentError if `one` number of a value is out of bounds."""
        finite = isinstance(one, int) or math.isfinite(one)
        require(finite and one <= self.most, name, value, f"finite, and at most {self.most:g}")
        holds = self.least <= one and self.above < one < self.below
        expected = f"{self.least:g} or above" if self.least > -math.inf else f"a number above {self.above:g}"
        if self.below < math.inf:
            expected = f"a number in [{self.least:g}, {self.below:g})"
        require(holds, name, value, self.expected or expected)


def bounded(most: float = WIDEST, *, acting: bool = False, **limits: Any) -> Any:
    """A field of one or several numbers, limited as in `Bounds`; with `acting` it affects no weights."""
    return field(metadata={BOUNDS: Bounds(most, **limits), ACTING: acting})


def one_of(*possible: str, acting: bool = False) -> Any:
    """A field whose value is one of these strings."""
    return field(metadata={BOUNDS: possible, ACTING: acting})


def require(holds: bool, name: str, got: object, expected: str) -> None:
    """Raises ArgumentError that names the field, unless `holds`."""
    if not holds:
        raise ArgumentError(f"{name} is {got!r}; expected {expected}")


class Checked:
    """Base of frozen dataclasses with bounded fields: values are checked on construction."""

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
        """Raises ArgumentError for values that cannot be combined."""


def values(config: Any, acting: bool | None = None, within: bool = False) -> dict[str, Any]:
    """Fields as nested mappings: all, or only those that do (or do not) affect `acting`; `within`: all do."""
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
    """Recursive merge of two mappings; values of `other` win."""
    found = dict(one)
    for key, value in other.items():
        both = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = merged(found[key], value) if both else value
    return found
