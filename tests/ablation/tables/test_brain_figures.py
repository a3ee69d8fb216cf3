"""The table of brains, compared with figures counted by hand."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import (
    GenerationRow,
    Published,
    append_row,
    brains,
    load,
    read_published,
    transposed,
    write_published,
)
from rf_exp.findings import Answer, Dialogue, Ruling
from tests.ablation.conftest import generation
from tests.ablation.tables.making import SUITE, at, generated, shown

PLANNED = {"makespan_s": 3.0, "bound_s": 2.0, "asked": 9}
DONE = Answer(1, Ruling.CARRIED_OUT, stated=9, understood=9, **PLANNED)
LACKING = Answer(1, Ruling.REFUSED, "out_of_reach", stated=4, understood=3, asked=9, missing=6)
STOPPED = Answer(1, Ruling.STOPPED, "dropped", stated=9, understood=9, **PLANNED)
MODEL = "openai+some-model"


def answered(brain: str, *dialogues: Dialogue) -> list[GenerationRow]:
    """A row for each of these dialogues: a success of 100 steps or more."""
    rows = generation("lift_barrier", "full", len(dialogues), 0, brain=brain)
    return [replace(row, dialogue=each) for row, each in zip(rows, dialogues, strict=True)]


SCRIPTED = answered("scripted", *[Dialogue((DONE,), busy=(50, 50))] * 2)
MODELS = answered(
    MODEL,
    Dialogue((LACKING, DONE, replace(LACKING, round=2)), 4, 1000, 200, busy=(100, 50)),
    Dialogue((STOPPED, DONE), 2, 500, 100, busy=(0, 0)),
)


def test_every_brain_has_a_line_once_there_is_another_than_the_scripted_one() -> None:
    assert not brains(generated(SCRIPTED), SUITE).lines
    table = brains(generated(SCRIPTED, MODELS), SUITE)
    assert [line.key for line in table.lines] == ["lift_barrier-scripted", f"lift_barrier-{MODEL}"]


def test_figures_are_those_of_the_answers() -> None:
    table, line = brains(generated(SCRIPTED, MODELS), SUITE), f"lift_barrier-{MODEL}"
    values = {
        column.key: cell.value for column, cell in zip(table.columns, table.lines[1].cells, strict=True)
    }
    assert values["first"] == 0.5 and values["success"] == 1.0 and at(table, line, "first").n == 2
    assert values["repaired"] == "100 / 100 / 100 %"
    assert values["repairs"] == "1.00 in 1.5 rounds"
    assert values["refusals"] == "out_of_reach 2, dropped 1; of 5"
    assert values["tokens"] == "750 + 150"
    assert values["idle"] == f"{(1 - 150 / 200 + 1) / 2:.2f}" and values["balance"] == "0.50"
    assert values["makespan"] == "1.500" and values["precision"] == "2 of 3"
    assert values["constraints"] == "5.7 / 5.0 / 4.0 of 9.0"  # means of LACKING twice, and STOPPED
    assert at(table, "lift_barrier-scripted", "tokens").value == "-"


def test_brains_are_columns_on_a_terminal() -> None:
    table = brains(generated(SCRIPTED, MODELS), SUITE)
    ((title, heading, rows),) = transposed(table, lambda cell: cell.markdown())
    assert title == "Lift Barrier" and heading == ["Brain", "scripted", MODEL]
    assert {len(row) for row in rows} == {3} and len(rows) == len(table.columns) - 1
    text = shown(table)
    assert "out_of_reach 2" in text and max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("suffix", [".jsonl", ".tsv"])
def test_rows_hold_their_dialogue(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"results/generate/lift_barrier/full{suffix}"
    if suffix == ".tsv":
        write_published(path, Published(tuple(MODELS)))
        assert read_published(path, GenerationRow).rows == tuple(MODELS)
    else:
        for row in MODELS:
            append_row(path, row)
        assert (
            json.loads(path.read_text().splitlines()[0])["dialogue"]["answers"][0]["code"] == "out_of_reach"
        )
    assert load(tmp_path).generation == tuple(MODELS)
