"""Identities are compared by value, leaf by leaf."""

import numpy as np
import pytest

from rf_exp.artifacts.identity import differing, digest
from rf_exp.errors import ArgumentError


def test_leaves_that_differ_are_named() -> None:
    found = {"task": {"name": "a", "x_m": (0.0, 1)}, "old": 1, "same": [1, 2]}
    wanted = {"task": {"name": "b", "x_m": [0, 1.0]}, "new": None, "same": (1, 2)}
    assert differing(found, wanted) == (
        "new: found nothing, wanted null",
        "old: found 1, wanted nothing",
        'task.name: found "a", wanted "b"',
    )


def test_numbers_are_compared_as_numbers() -> None:
    assert differing({"x": 0, "y": np.float32(0.5)}, {"x": 0.0, "y": 0.5}) == ()


def test_a_digest_is_of_the_values() -> None:
    assert digest({"a": 1, "b": (2, 3)}) == digest({"b": [2, 3], "a": 1}) != digest({"a": 1, "b": [3, 2]})


@pytest.mark.parametrize("value", [object(), float("nan")])
def test_only_plain_values(value: object) -> None:
    with pytest.raises(ArgumentError, match="described by plain JSON values"):
        digest({"x": value})
