"""Published rows, made again: the same ones are told to be so, any that differ are named."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp import verify
from rf_exp.ablation import GenerationRow
from rf_exp.command import guarded
from rf_exp.errors import ArgumentError
from rf_exp.verify import __main__ as command

RESULTS = Path(__file__).parents[1] / "results"


def told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], path: Path, **changes: object
) -> tuple[int, str, str]:
    """The command, where the third seed comes out with these changes."""

    def again(rows: Sequence[GenerationRow], *_: object) -> tuple[GenerationRow, ...]:
        return tuple(replace(row, wall_s=9.0, **(changes if k == 2 else {})) for k, row in enumerate(rows))

    monkeypatch.setattr(command, "made_again", again)
    monkeypatch.setattr(sys, "argv", ["rf_exp.verify", str(path)])
    code = guarded(command.main)
    said = capsys.readouterr()
    return code, said.out.replace("\n", " "), said.err


def test_rows_that_come_out_as_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said, _ = told(monkeypatch, capsys, RESULTS / "expert/pick_meat.tsv")
    assert code == 0 and "10 rows came out as told (generator " in said


def test_a_row_that_does_not_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said, complained = told(
        monkeypatch, capsys, RESULTS / "expert/pick_meat.tsv", success=False, steps=99
    )
    assert code == 1 and "1 of 1 files did not come out as told" in complained
    assert "seed 2: success is told as True, and came out as False" in said
    assert "seed 2: steps is told as 69, and came out as 99" in said


def test_a_seed_that_is_missing_is_named() -> None:
    rows = verify.published(RESULTS / "expert/pick_meat.tsv", 3)
    assert list(verify.differences(rows, rows[:2])) == ["seed 2: nothing came out"]


@pytest.mark.parametrize(
    ("name", "seeds", "said"),
    [
        ("nope.tsv", 1, "there is no file"),
        (".", 1, "there is no file"),
        ("nope.tsv", 0, "--seeds is 0; expected 1 or more"),
    ],
)
def test_what_cannot_be_verified_is_told(tmp_path: Path, name: str, seeds: int, said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        verify.published(tmp_path / name, seeds)


def test_rows_of_policies_are_refused_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = RESULTS / "evaluate/lift_barrier/separate_local/full-fast-50.tsv"
    code, _, complained = told(monkeypatch, capsys, path)
    assert code == 2 and "holds rows of policies, whose weights are not among the results" in complained
