"""Which rollouts are filmed, how their files are called, and which failures are of one kind."""

from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation.rollouts import kind_of, rollout_file, worth_seeing
from rf_exp.ablation.rows import EvaluationRow
from tests.ablation.conftest import evaluation

UP = "failed: up (never: 0.02 m, best 0.11, asked > 0.15); at best 0 of 1"
UP_LATER = "failed: up (since 3.10 s: 0.1 m, asked > 0.15); at best 1 of 1 (0.05 s)"
TOO_LATE = "all conditions held, but not for long"
TOUCHED = (
    "failed: up (never); at best 0 of 1; agents 1 and 2 touched (0.10 s, 2 steps); steak dropped (0.2 s)"
)


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        (UP, "up"),
        (UP_LATER, "up"),
        (TOUCHED, "up; agents 1 and 2 touched; steak dropped"),
        ("failed: all conditions held, but not for long (2 steps at the end)", TOO_LATE),
        ("", "no reason given"),
    ],
)
def test_failures_that_differ_only_in_numbers_are_of_one_kind(reason: str, kind: str) -> None:
    assert kind_of(reason) == kind


def rows(*reasons: str) -> list[EvaluationRow]:
    """A row for each: empty for a success."""
    return [
        replace(row, success=not reason, reason=reason)
        for row, reason in zip(evaluation("t", "a", 5, 0, len(reasons)), reasons, strict=True)
    ]


def test_failures_of_different_kinds_are_seen_first() -> None:
    found = rows("", UP, "", UP_LATER, "", TOUCHED)
    first = 1_000_000
    assert worth_seeing(found, 2) == (first, first + 2, first + 1, first + 5)
    assert worth_seeing(found[::-1], 2) == worth_seeing(found, 2)  # rows may be written in any order
    assert worth_seeing(found, 3)[3:] == (first + 1, first + 5, first + 3)
    assert worth_seeing(found, 0) == ()


def test_a_scene_that_was_never_begun_is_not_filmed() -> None:
    [row] = rows("ended after 3600 s")
    assert worth_seeing([replace(row, steps=0)], 2) == ()


def test_files_of_policies_that_were_trained_from_other_seeds_are_apart() -> None:
    [row] = rows("")
    folder = Path("recordings/t/full")
    assert rollout_file(row, ".mp4") == folder / "evaluate-a-paper-5-1000000.mp4"
    assert rollout_file(replace(row, train_seed=3), ".mp4") == folder / "evaluate-a-paper-5-t3-1000000.mp4"
    assert rollout_file(replace(row, shield=True), ".mp4") == folder / "evaluate-a-paper-5-shield-1000000.mp4"
