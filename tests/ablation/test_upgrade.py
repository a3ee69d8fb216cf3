"""Rows of older schemas: what is kept in results/, and every form that their sentences had."""

import json
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows
from rf_exp.ablation.upgrade import upgraded
from rf_exp.artifacts import restored
from rf_exp.errors import ArgumentError
from rf_exp.findings import Account
from tests.conftest import CONF

RESULTS = CONF.parent / "results"


def account(reason: str) -> Account:
    return restored(Account, upgraded({"schema": 5, "reason": reason})["account"])


@pytest.mark.slow
def test_kept_rows_of_rollouts_say_what_their_lines_say() -> None:
    failures = 0
    for path in sorted(RESULTS.glob("evaluate/**/*.jsonl")):
        for line, row in zip(path.read_text().splitlines(), read_rows(path, EvaluationRow), strict=True):
            assert row.reason == json.loads(line)["reason"] and row.success == (not row.reason)
            closest = row.account.closest
            briefly = closest is not None and closest.holding == closest.of  # all held, but too shortly
            assert not row.account.unmet if row.success else row.account.unmet or briefly
            failures += not row.success
    assert failures > 100


@pytest.mark.slow
def test_kept_rows_of_generation_say_what_their_lines_say() -> None:
    failures = 0
    for path in sorted([*RESULTS.glob("ablation/**/*.jsonl"), *RESULTS.glob("expert/*.jsonl")]):
        for line, row in zip(path.read_text().splitlines(), read_rows(path, GenerationRow), strict=True):
            assert row.reason == json.loads(line)["reason"] and row.success == (not row.reason)
            failures += not row.success
    assert failures > 100


OLD = (
    '{"task": "take_photo", "constraints": "logical", "brain": "scripted", "seed": 2, '
    '"success": false, "success_paper": true, "steps": 396, "attempts": 2, '
    '"reason": "not camera level; the first violation of 1: Agent_4, standing still, '
    'pushes camera with 23 N (arms stop at 20 N)", "wall_s": 1.432, "version": "1", '
    '"violations": 1, "contacts": 0, "generator": "1.1", "commit": "5985e1888175", "schema": 2, '
    '"crc32": "fb0bd7fe"}'
)


def test_a_row_of_generation_of_an_older_schema_tells_which_conditions_did_not_hold(tmp_path: Path) -> None:
    (tmp_path / "old.jsonl").write_text(OLD + "\n")
    (row,) = read_rows(tmp_path / "old.jsonl", GenerationRow)
    assert [each.name for each in row.account.unmet] == ["camera level"]
    assert "Agent_4, standing still, pushes camera with 23 N" in row.reason


@pytest.mark.parametrize(
    "reason",
    [
        "failed: held by both arms (since 4.10 s), lifted (never: 0.02 m, best 0.11, asked > 0.15); at best "
        "3 of 4 (3.95 s); agents 1 and 2 touched (2.30 s, 14 steps); barrier out of reach (4.10 s)",
        "failed: at rest (since 0.10 s: 7.2 m/s, asked < 5); at best 1 of 1 (0.05 s, for 1 steps)",
        "failed: up (never); at best 0 of 1",
    ],
)
def test_a_sentence_about_a_rollout_is_read_whole(reason: str) -> None:
    assert account(reason).reason == reason


def test_what_only_words_tell_stays_words() -> None:
    early = account("failed: all conditions held, but not for long (2 steps at the end)")
    assert early.reason == "failed: all conditions held, but not for long (2 steps)"
    told = account(
        "not up; the first violation of 2: Agent_1 is 0.2 rad off its path; the last: it is 1.5 late"
    )
    assert [each.name for each in told.unmet] == ["up"]
    assert told.kind == "up; the first violation of 2: Agent_1 is … rad off its path; the last: it is … late"
    assert account("no result after 1 s; its process, asleep, was killed").ended.startswith("no result after")
    assert account("success was not held long enough").kind == "all conditions held, but not for long"


@pytest.mark.parametrize("reason", ["the arm fell off", "failed: up", "failed: up (never); it rained"])
def test_a_sentence_of_another_form_is_refused(reason: str) -> None:
    with pytest.raises(ArgumentError, match=r"of older rows|no condition that did not hold"):
        account(reason)
