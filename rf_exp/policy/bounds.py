"""Bounds of configuration fields, declared with each field and checked on construction.

A configuration may come with a policy from someone else, so every number is bounded: far above useful values,
and below those that would exhaust memory or run forever.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from rf_exp.errors import ArgumentError, unknown_choice

MOST_ITEMS, LARGEST_WIDTH = 8, 8192  # most items of a list, such as layers of a network; widest layer
BOUNDS, ACTING = "bounds", "acting"  # keys of the metadata of a field


@dataclass(frozen=True)
class Bounds:
    """Limits of the numbers of a field, and their wording in errors."""

    most: float = math.inf
    least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    expected: str = ""

    def check(self, name: str, value: object, number: float) -> None:
        """Raises ArgumentError if this number of a value is out of bounds."""
        finite = isinstance(number, int) or math.isfinite(number)
        require(finite and number <= self.most, name, value, f"finite, and at most {self.most:g}")
        holds = self.least <= number and self.above < number < self.below
        expected = f"{self.least:g} or above" if self.least > -math.inf else f"a number above {self.above:g}"
        if self.below < math.inf:
            expected = f"a number in [{self.least:g}, {self.below:g})"
        require(holds, name, value, self.expected or expected)


def bounded(most: float = LARGEST_WIDTH, *, acting: bool = False, **limits: Any) -> Any:
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
        for field_ in fields(self):  # pyright: ignore[reportArgumentType]
            value, bounds = getattr(self, field_.name), field_.metadata.get(BOUNDS, Bounds())
            if isinstance(bounds, tuple):
                if value not in bounds:
                    raise unknown_choice(field_.name, value, bounds)
                continue
            several = isinstance(value, tuple)
            for number in value if several else (value,):
                if isinstance(number, bool):
                    require(field_.type is bool, field_.name, value, "a number")
                elif isinstance(number, int | float):
                    bounds.check(field_.name, value, number)
            require(
                not several or len(value) <= MOST_ITEMS, field_.name, value, f"at most {MOST_ITEMS} of them"
            )
        self.check()

    def check(self) -> None:
        """Raises ArgumentError for values that cannot be combined."""


def values(config: Any, acting: bool | None = None, all_acting: bool = False) -> dict[str, Any]:
    """Fields as nested mappings: all, or those that do (or do not) affect `acting`; `all_acting`: all do."""
    result: dict[str, Any] = {}
    for field_ in fields(config):
        value, affects_acting = getattr(config, field_.name), all_acting or field_.metadata.get(ACTING, False)
        if is_dataclass(value):
            inner = values(value, acting, affects_acting)
            result |= {field_.name: inner} if inner else {}
        elif acting is None or affects_acting == acting:
            result[field_.name] = value
    return result


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Recursive merge of two mappings; values of `override` win."""
    result = dict(base)
    for key, value in override.items():
        are_mappings = isinstance(value, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merged(result[key], value) if are_mappings else value
    return result
