"""Cells format themselves: Markdown, LaTeX and CSV of each kind, with and without a figure."""

from dataclasses import replace

import pytest

from rf_exp.ablation import Estimate
from rf_exp.ablation.tables.table import (
    Cell,
    Column,
    Length,
    Line,
    Rate,
    Table,
    Text,
    Violations,
    with_violations,
)

CLEAN = Estimate(0.5, 0.25, 0.75, 8)


@pytest.mark.parametrize(
    ("cell", "markdown", "latex"),
    [
        (Text("50 % & more"), "50 % & more", r"50 \% \& more"),
        (Rate(), "missing", "missing"),
        (Rate(0.75, 8, (0.4, 0.9)), "**75.0 %**, [40.0, 90.0] n=8", r"\textbf{75.0 \%}, [40.0, 90.0] n=8"),
        (
            Rate(0.75, 8, (0.4, 0.9), success_paper=1.0, clean=CLEAN),
            "**75.0 %**, [40.0, 90.0] n=8, without a violation **50.0 %** [25.0, 75.0], "
            "paper's criterion 100.0 %",
            r"\textbf{75.0 \%}, [40.0, 90.0] n=8, without a violation \textbf{50.0 \%} [25.0, 75.0], "
            r"paper's criterion 100.0 \%",
        ),
        (Rate(0.75, 8, success_paper=0.75), "**75.0 %**, n=8", r"\textbf{75.0 \%}, n=8"),
        (Length(80.71, 3, (79.0, 1234.5)), "**80.7**, [79.0, 1234] n=3", r"\textbf{80.7}, [79.0, 1234] n=3"),
        (Length(placeholder="no success"), "no success", "no success"),
        (
            Violations(0.125, 8, (0.0, 0.5), mean_violations=1.5),
            "**12.5 %**, [0.0, 50.0], mean 1.50",
            r"\textbf{12.5 \%}, [0.0, 50.0], mean 1.50",
        ),
    ],
)
def test_a_cell_is_written_with_all_its_details(cell: Cell, markdown: str, latex: str) -> None:
    assert (cell.markdown(), cell.latex()) == (markdown, latex)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        (Text("x"), {"status": "text", "value": "x", "n": 0}),
        (Rate(paper=0.9), {"status": "missing", "value": None, "n": 0, "paper": 0.9, "clean": None}),
        (
            Rate(0.75, 8, (0.4, 0.9), "a note", "2", success_paper=1.0, clean=CLEAN),
            {
                **{"status": "measured", "value": 0.75, "low": 0.4, "high": 0.9, "n": 8, "version": "2"},
                **{
                    "note": "a note",
                    "success_paper": 1.0,
                    "clean": 0.5,
                    "clean_low": 0.25,
                    "clean_high": 0.75,
                },
            },
        ),
        (
            Length(placeholder="no success", paper=204.0),
            {"status": "measured", "value": "no success", "paper": 204.0},
        ),
        (
            Violations(0.125, 8, mean_violations=1.5),
            {"status": "measured", "value": 0.125, "mean_violations": 1.5},
        ),
    ],
)
def test_csv_holds_the_numbers_as_they_are(cell: Cell, said: dict[str, object]) -> None:
    assert said.items() <= cell.csv().items()


def test_a_rate_without_a_violation_is_separate_if_it_differs() -> None:
    assert Rate(0.5, 8, clean=CLEAN).clean_if_different is None
    assert Rate(0.75, 8, clean=CLEAN).clean_if_different == CLEAN
    assert Rate(0.75, 8).estimate is None  # an average has no interval
    assert Rate(0.75, 8, (0.4, 0.9)).estimate == Estimate(0.75, 0.4, 0.9, 8)


def test_lines_and_columns_without_figures_are_left_out_and_named() -> None:
    columns = (Column("agents", "Agents", Text), *with_violations("a", "First"), Column("b", "Second", Rate))
    some, none = Rate(0.5, 10), Rate(None, 0)
    lines = (
        Line("one", "One", (Text("1"), some, Violations(0.1, 10), none)),
        Line("two", "Two", (Text("2"), none, Violations(None, 0), none)),
        Line("mean", "Average", (Text(""), none, Violations(None, 0), none), average=True),
    )
    table = Table("t", "T", "", "Task", columns, lines, ("known",))
    reduced = table.without_empty
    assert [line.key for line in reduced.lines] == ["one"]
    assert [column.key for column in reduced.columns] == ["agents", "a", "a_violations"]
    assert reduced.cell("one", "a") == some
    assert reduced.notes == ("known", "Not measured yet: Two.", "Not measured yet: Second.")
    nothing = replace(table, lines=lines[1:])
    assert nothing.without_empty == nothing
