"""Verification of published rows: equal rows are confirmed, differences are named."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp import verify
from rf_exp.ablation import GenerationRow
from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError
from rf_exp.verify import __main__ as command

RESULTS = Path(__file__).parents[1] / "results"


def run_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], path: Path, **changes: object
) -> tuple[int, str, str]:
    """The command, with these changes in the regenerated row of the third seed."""

    def regenerate(rows: Sequence[GenerationRow], *_: object) -> tuple[GenerationRow, ...]:
        return tuple(replace(row, wall_s=9.0, **(changes if k == 2 else {})) for k, row in enumerate(rows))

    monkeypatch.setattr(command, "regenerate", regenerate)
    monkeypatch.setattr(sys, "argv", ["rf_exp.verify", str(path)])
    code = run_guarded(command.main)
    output = capsys.readouterr()
    return code, output.out.replace("\n", " "), output.err


def test_equal_rows_are_confirmed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, output, _ = run_command(monkeypatch, capsys, RESULTS / "expert/pick_meat.tsv")
    assert code == 0 and "10 rows are reproduced (generator " in output


def test_a_differing_row_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, output, errors = run_command(
        monkeypatch, capsys, RESULTS / "expert/pick_meat.tsv", success=False, steps=99
    )
    assert code == 1 and "1 of 1 files were not reproduced" in errors
    assert "seed 2: success is True as published, False as regenerated" in output
    assert "seed 2: steps is 69 as published, 99 as regenerated" in output


def test_a_missing_seed_is_named() -> None:
    rows = verify.read_published_rows(RESULTS / "expert/pick_meat.tsv", 3)
    assert list(verify.differences(rows, rows[:2])) == ["seed 2: no row was regenerated"]


@pytest.mark.parametrize(
    ("name", "seeds", "message"),
    [
        ("nope.tsv", 1, "there is no file"),
        (".", 1, "there is no file"),
        ("nope.tsv", 0, "--seeds is 0; expected 1 or more"),
    ],
)
def test_unverifiable_arguments_are_refused(tmp_path: Path, name: str, seeds: int, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        verify.read_published_rows(tmp_path / name, seeds)


def test_rows_of_policies_are_refused_with_advice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = RESULTS / "evaluate/lift_barrier/separate_local/full-fast-50.tsv"
    code, _, errors = run_command(monkeypatch, capsys, path)
    assert code == 2 and "holds rows of policies, whose weights are not among the results" in errors
