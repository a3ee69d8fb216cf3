"""Identities: comparison by value, leaf by leaf, digests, and dataclasses as plain values."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from rf_exp.artifacts import digest, expect_same, find_differences, plain, restored
from rf_exp.errors import ArgumentError, StageError


def test_differing_leaves_are_named() -> None:
    found = {"task": {"name": "a", "x_m": (0.0, 1)}, "old": 1, "same": [1, 2]}
    expected = {"task": {"name": "b", "x_m": [0, 1.0]}, "new": None, "same": (1, 2)}
    assert find_differences(found, expected) == (
        "new: found nothing, wanted null",
        "old: found 1, wanted nothing",
        'task.name: found "a", wanted "b"',
    )


def test_numbers_are_compared_as_numbers() -> None:
    assert find_differences({"x": 0, "y": np.float32(0.5)}, {"x": 0.0, "y": 0.5}) == ()


def test_a_digest_depends_on_the_values_only() -> None:
    assert digest({"a": 1, "b": (2, 3)}) == digest({"b": [2, 3], "a": 1}) != digest({"a": 1, "b": [3, 2]})


@pytest.mark.parametrize("value", [object(), float("nan")])
def test_other_than_plain_values_are_refused(value: object) -> None:
    with pytest.raises(ArgumentError, match="described by plain JSON values"):
        digest({"x": value})


@dataclass(frozen=True)
class Inner:
    at: tuple[float, ...]
    later: str = ""


@dataclass(frozen=True)
class Outer:
    parts: tuple[Inner, ...]
    count: int


def test_a_dataclass_is_restored_from_json() -> None:
    value = Outer((Inner((0.5, 1.0), "x"), Inner(())), 3)
    plain_value = {"parts": [{"at": [0.5, 1.0], "later": "x"}, {"at": [], "later": ""}], "count": 3}
    assert plain(value) == plain_value
    assert restored(Outer, plain_value) == value
    older = {"parts": [{"at": [2]}], "count": 3}  # from before `later` existed, with 2.0 written by hand as 2
    assert restored(Outer, older) == Outer((Inner((2.0,)),), 3)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"parts": []}, "count"),
        ({"parts": [], "count": 1, "colour": "red"}, "colour"),
        ({"parts": [], "count": "1"}, "count"),
    ],
)
def test_invalid_fields_of_a_dataclass_are_named(values: dict[str, object], key: str) -> None:
    with pytest.raises(ArgumentError, match=key):
        restored(Outer, values)


def test_an_artifact_of_another_configuration_is_refused() -> None:
    expect_same(Path("a.zarr"), {"a": (1, 2)}, {"a": [1, 2]}, "delete it")
    message = r"^a\.zarr was made from another configuration \(a: found 1, wanted 2\); delete it$"
    with pytest.raises(StageError, match=message):
        expect_same(Path("a.zarr"), {"a": 1}, {"a": 2}, "delete it")
