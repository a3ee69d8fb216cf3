"""Rollouts: which are filmed, names of their files, kinds of failures, scores and descriptions."""

from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, load, rollout_file, seeds_to_film
from rf_exp.ablation.report import learnt_from
from rf_exp.findings import NO_STEPS, Account, Closest, Lost, Touch, Unmet
from tests.ablation.conftest import evaluation

ROOT = Path(__file__).parents[2]
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
    """A row for each account; None for a success."""
    return [
        replace(row, success=account is None, account=account or Account())
        for row, account in zip(evaluation("t", "a", 5, 0, len(accounts)), accounts, strict=True)
    ]


def test_failures_of_different_kinds_are_seen_first() -> None:
    found = rows(None, UP, None, UP_LATER, None, TOUCHED)
    first = 1_000_000
    assert seeds_to_film(found, 2) == (first, first + 2, first + 1, first + 5)
    assert seeds_to_film(found[::-1], 2) == seeds_to_film(found, 2)  # rows may be written in any order
    assert seeds_to_film(found, 3)[3:] == (first + 1, first + 5, first + 3)
    assert seeds_to_film(found, 0) == ()


def test_a_scene_that_never_started_is_not_filmed() -> None:
    [row] = rows(Account(ended="no result after 3600 s"))
    assert seeds_to_film([replace(row, steps=0)], 2) == ()


def test_files_of_policies_that_were_trained_from_other_seeds_are_apart() -> None:
    [row] = rows(None)
    folder = Path("recordings/t/full")
    assert rollout_file(row, ".mp4") == folder / "evaluate-a-paper-5-1000000.mp4"
    assert rollout_file(replace(row, train_seed=3), ".mp4") == folder / "evaluate-a-paper-5-t3-1000000.mp4"
    assert rollout_file(replace(row, shield=True), ".mp4") == folder / "evaluate-a-paper-5-shield-1000000.mp4"


def test_a_score_comes_from_the_account_and_is_unknown_where_nothing_was_judged() -> None:
    """So older rows have a score too, except for scenes that were ended from outside."""
    partly = Account(closest=Closest(2, 3, 1.0, 0), touches=(Touch((1, 2), 0.1, 2),))
    ended = Account(ended="took longer than 3600 s")
    found = [row.score for row in rows(None, UP, UP_LATER, partly, Account(closest=NO_STEPS), ended)]
    assert found == [1.0, 0.0, 0.5, 0.5, 0.0, None]
    assert all(row.score is not None for row in load(ROOT).evaluation)  # all published rows


@pytest.mark.parametrize(
    ("recipe", "learned_on"),
    [
        ("fast", "none"),
        ("fast+full", "full"),
        ("fast+dagger1", "none"),
        ("fast+full+dagger2", "full"),
        ("fast+light+table", "light+table"),
    ],
)
def test_a_recipe_names_the_variation_that_was_learned_on(recipe: str, learned_on: str) -> None:
    (row,) = evaluation("t", "separate_local", 5, 1, 0, recipe=recipe)
    assert row.learned_on == learned_on
    assert replace(row, arch="foreign").learned_on == "none"  # names of foreign policies are free


def test_the_description_names_the_variation_of_scenes() -> None:
    (usual,) = evaluation("t", "separate_local", 5, 1, 0, recipe="fast", shield=True)
    assert learnt_from(usual) == "full, 5 demonstrations, recipe fast, shielded"
    assert learnt_from(replace(usual, variation="light")) == f"{learnt_from(usual)}, in scenes of light"
