"""Which rollouts are filmed, how their files are called, and which failures are of one kind."""

from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, worth_seeing
from rf_exp.ablation.rollouts import rollout_file
from rf_exp.findings import Account, Closest, Lost, Touch, Unmet
from tests.ablation.conftest import evaluation

UP = Account(unmet=(Unmet("up", 0.0, 0.02, 0.11, 0.15, "m", True),), closest=Closest(0, 1, 0.0, 0))
UP_LATER = Account(unmet=(Unmet("up", 3.1, 0.1, 0.2, 0.15, "m", True),), closest=Closest(1, 1, 0.05, 1))
TOUCHED = replace(UP, touches=(Touch((1, 2), 0.1, 2),), lost=(Lost("steak", "dropped", 0.2),))


@pytest.mark.parametrize(
    ("account", "kind"),
    [
        (UP, "up"),
        (UP_LATER, "up"),
        (TOUCHED, "up; agents 1 and 2 touched; steak dropped"),
        (Account(closest=Closest(1, 1, 0.05, 2)), "all conditions held, but not for long"),
    ],
)
def test_failures_that_differ_only_in_numbers_are_of_one_kind(account: Account, kind: str) -> None:
    assert account.kind == kind


def rows(*accounts: Account | None) -> list[EvaluationRow]:
    """A row for each: None for a success."""
    return [
        replace(row, success=account is None, account=account or Account())
        for row, account in zip(evaluation("t", "a", 5, 0, len(accounts)), accounts, strict=True)
    ]


def test_failures_of_different_kinds_are_seen_first() -> None:
    found = rows(None, UP, None, UP_LATER, None, TOUCHED)
    first = 1_000_000
    assert worth_seeing(found, 2) == (first, first + 2, first + 1, first + 5)
    assert worth_seeing(found[::-1], 2) == worth_seeing(found, 2)  # rows may be written in any order
    assert worth_seeing(found, 3)[3:] == (first + 1, first + 5, first + 3)
    assert worth_seeing(found, 0) == ()


def test_a_scene_that_was_never_begun_is_not_filmed() -> None:
    [row] = rows(Account(ended="no result after 3600 s"))
    assert worth_seeing([replace(row, steps=0)], 2) == ()


def test_files_of_policies_that_were_trained_from_other_seeds_are_apart() -> None:
    [row] = rows(None)
    folder = Path("recordings/t/full")
    assert rollout_file(row, ".mp4") == folder / "evaluate-a-paper-5-1000000.mp4"
    assert rollout_file(replace(row, train_seed=3), ".mp4") == folder / "evaluate-a-paper-5-t3-1000000.mp4"
    assert rollout_file(replace(row, shield=True), ".mp4") == folder / "evaluate-a-paper-5-shield-1000000.mp4"
