"""Published files of rows: a table below a header of constants; reading gives what was written."""

import csv
import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from rf_exp.ablation import (
    PUBLISHED,
    EvaluationRow,
    GenerationRow,
    Published,
    load,
    read_published,
    read_rows,
    write_published,
)
from rf_exp.artifacts import plain
from rf_exp.errors import StageError
from rf_exp.findings import Account
from tests.ablation.conftest import evaluation, generation
from tests.conftest import CONF

RESULTS = CONF.parent / "results"
POLICIES = Published(
    (
        *evaluation("lift_barrier", "separate_local", 50, 2, 1),
        *evaluation("lift_barrier", "separate_local", 50, 1, 1, train_seed=3),
    ),
    {"step_limit": 200, "training": {"betas": [0.9, 0.99]}},
    {0: {"data": {"seeds": [1, 2]}, "weights": "a"}, 3: {"data": {"seeds": [1, 2]}, "weights": "b"}},
    {3: {"agent1": {"step": [200], "loss": [0.1], "core_s": [1.5]}}},
)


@pytest.mark.parametrize(
    "published",
    [
        POLICIES,
        replace(POLICIES, made={0: {"data": 1}, 3: {"data": 1}}),
        replace(POLICIES, rows=POLICIES.rows[:1], made={0: {"data": 1}}),
        Published(tuple(generation("lift_barrier", "full", 3, 4, violations=(0, 2)))),
        Published(tuple(generation("lift_barrier", "full", 3, 0))),
        Published((replace(generation("lift_barrier", "full", 1, 0)[0], wall_s=1e-17, commit=""),)),
        Published(
            (replace(generation("pot", "full", 0, 1)[0], account=Account(ended="a\tb\n# \ud83d é")),) * 2
        ),
    ],
    ids=lambda published: f"{len(published.rows)} rows",
)
def test_published_rows_are_read_back(tmp_path: Path, published: Published) -> None:
    path = tmp_path / f"new/rows{PUBLISHED}"
    write_published(path, published)
    assert read_published(path, type(published.rows[0])) == published
    assert read_rows(path, type(published.rows[0])) == published.rows


def test_constants_are_in_the_header_and_the_rest_is_a_plain_table(tmp_path: Path) -> None:
    path = tmp_path / f"rows{PUBLISHED}"
    write_published(path, POLICIES)
    head_lines = [line[2:].partition(": ") for line in path.read_text().splitlines() if line.startswith("# ")]
    header = {name: json.loads(value) for name, _, value in head_lines}
    assert list(header) == ["rows", "constant", "asked", "made", "made.0", "made.3", "curves.3"]
    assert header["made"] == {"data": {"seeds": [1, 2]}} and header["made.3"] == {"weights": "b"}
    lines = [line for line in path.read_text().splitlines() if not line.startswith("# ")]
    table = list(csv.DictReader(lines, delimiter="\t", quoting=csv.QUOTE_NONE))
    assert {*table[0]} | {*header["constant"]} == {each.name for each in fields(EvaluationRow)}
    assert {*table[0]} == {"train_seed", "scene_seed", "success", "success_paper", "account"}
    for cells, row in zip(table, POLICIES.rows, strict=True):
        assert cells["success"] == str(int(row.success)) and cells["scene_seed"] == str(row.scene_seed)
        assert json.loads(cells["account"]).keys() == ({*()} if row.success else {"unmet"})
        assert all(plain(row)[name] == value for name, value in header["constant"].items())


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (EvaluationRow, lambda text: text.replace("\t0\t0\t", "\t1\t1\t"), "damaged or edited: it begins"),
        (EvaluationRow, lambda text: text[:-20], "damaged or edited: it begins"),
        (EvaluationRow, lambda text: "", "damaged or edited: it begins"),
        (GenerationRow, lambda text: text, '"EvaluationRow".* expected .*"GenerationRow"'),
    ],
)
def test_a_published_file_that_is_not_as_it_was_written_is_refused(
    tmp_path: Path, kind: type, change, message: str
) -> None:
    path = tmp_path / f"rows{PUBLISHED}"
    write_published(path, POLICIES)
    path.write_text(change(path.read_text()))
    with pytest.raises(
        StageError, match=rf"rows\.tsv: no published {kind.__name__}s: .*{message}.*publish its"
    ):
        read_published(path, kind)


def test_published_rows_of_another_schema_are_refused(tmp_path: Path) -> None:
    path = tmp_path / f"rows{PUBLISHED}"
    write_published(path, Published(tuple(replace(row, schema=7) for row in POLICIES.rows)))
    with pytest.raises(StageError, match="a row of schema 7, made by another version; this version reads"):
        read_published(path, EvaluationRow)
    with pytest.raises(StageError, match=r"cannot read result rows from .*nothing"):
        read_published(tmp_path / f"nothing{PUBLISHED}", EvaluationRow)


def test_a_report_reads_rows_of_both_formats(tmp_path: Path) -> None:
    folder = tmp_path / "results/evaluate/lift_barrier/separate_local"
    write_published(folder / f"full-fast-50{PUBLISHED}", POLICIES)
    (folder / "full-fast-50.configuration.json").write_text("{}")
    assert load(tmp_path).evaluation == POLICIES.rows


def test_shielded_rows_must_be_of_the_policies_beside_them(tmp_path: Path) -> None:
    folder = tmp_path / "results/evaluate/lift_barrier/separate_local"
    shielded = replace(POLICIES, rows=tuple(replace(row, shield=True) for row in POLICIES.rows))
    write_published(folder / f"full-fast-50{PUBLISHED}", POLICIES)
    write_published(folder / f"full-fast-50-shield{PUBLISHED}", shielded)
    assert len(load(tmp_path).evaluation) == 2 * len(POLICIES.rows)
    other = replace(shielded, made={**shielded.made, 3: {**shielded.made[3], "weights": "c"}})
    write_published(folder / f"full-fast-50-shield{PUBLISHED}", other)
    with pytest.raises(
        StageError, match=r"50-shield\.tsv is of other policies .*50\.tsv \(training seed 3\)"
    ):
        load(tmp_path)


@pytest.mark.slow
def test_published_rows_have_a_reason_for_each_failure() -> None:
    failures = 0
    for path in sorted(RESULTS.rglob("*")):
        if path.is_dir():
            continue
        kind = EvaluationRow if path.is_relative_to(RESULTS / "evaluate") else GenerationRow
        for row in read_rows(path, kind):
            assert row.success == (not row.reason)
            failures += not row.success
            if kind is EvaluationRow:
                closest = row.account.closest
                briefly = closest is not None and closest.holding == closest.of  # all held, but too shortly
                assert not row.account.unmet if row.success else row.account.unmet or briefly
    assert failures > 200
