"""Tables as files and on a terminal."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from rf_exp.ablation import Results, configured, formats, load
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.table import Figure, Rate
from rf_exp.errors import StageError
from tests.ablation.tables.making import EMPTY, NAMES, counted, made, shown


def test_files_hold_the_figures(out: Path) -> None:
    for table in build(load(out), configured()).values():
        paths = formats.write(table, out / "tables")
        assert [path.name for path in paths] == [f"{table.name}.{suffix}" for suffix in ("md", "csv", "tex")]
    markdown = (out / "tables/ablation_success.md").read_text()
    heading = (
        "| Constraints | Lift Barrier | paper | violations | Three Robots Stack Cube | paper | violations |"
    )
    assert heading in markdown
    clean = "without a violation **60.0 %** [31.3, 83.2]"
    assert f"| **60.0 %**, [31.3, 83.2] n=10, {clean}, paper's criterion 80.0 % | 80.2 % | " in markdown
    assert "| 80.2 % | **0.0 %**, [0.0, 27.8], mean 0.00 | " in markdown
    assert "missing | 62.5 % | missing |" in markdown
    rows = list(csv.DictReader(io.StringIO((out / "tables/architectures.csv").read_text())))
    (cell,) = [r for r in rows if (r["row"], r["column"]) == ("separate_local-150", "lift_barrier")]
    assert (float(cell["value"]), int(cell["n"]), float(cell["paper"])) == (0.6, 20, 0.58)
    assert float(cell["low"]) < 0.6 < float(cell["high"])
    (cell,) = [r for r in rows if (r["row"], r["column"]) == ("separate_local-150", "place_food")]
    assert (cell["value"], cell["status"], float(cell["paper"])) == ("", "missing", 0.2)


def test_latex_is_well_formed(out: Path) -> None:
    for table in build(load(out), configured()).values():
        text = formats.latex(table)
        alignment = text.split(r"\begin{tabular}{")[1].split("}\n")[0]
        wanted = alignment.replace("p{4cm}", "p").count("l") + alignment.count("p{")
        body = text.split(r"\midrule")[1].split(r"\bottomrule")[0].strip().splitlines()
        assert len(body) == len(table.lines)
        for line in body:
            assert line.replace(r"\&", "").count("&") == wanted - 1
            assert "%" not in line.replace(r"\%", "")


def test_the_terminal_shows_figures_but_no_long_texts(out: Path) -> None:
    text = "".join(shown(table) for table in build(load(out), configured()).values())
    assert "[31.3, 83.2] n=10" in text
    assert "predefined threshold" not in text


def test_a_note_of_several_tables_is_shown_once(out: Path) -> None:
    tables, terminal, shown_notes = build(load(out), configured()), io.StringIO(), set[str]()
    several = [replace(table, notes=("of them all",)) for table in tables.values() if table.measured]
    assert len(several) > 1
    for table in several:
        formats.show(table, Console(file=terminal, width=80), shown_notes)
    assert terminal.getvalue().count("- of them all") == 1 and "of them all" in shown_notes


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_terminal_of_80_columns_holds_every_table(name: str) -> None:
    """Nothing is cut off, and no word or figure is broken in two."""
    made_rows, rolled = counted()
    table = made(name, Results(tuple(made_rows), tuple(rolled)))
    text = shown(table)
    assert all(len(line) <= 80 for line in text.splitlines())
    words = set(text.split())
    for line in table.lines:
        for index, after in table.compared:
            expected = set(line.title.split()) | set(table.columns[index].title.split())
            for place in (index, *([] if after is None else [after])):
                cell = line.cells[place]
                assert isinstance(cell, Figure)
                expected |= set(" ".join([cell.figure, *cell.details]).split())
                expected |= set(" ".join(cell.clean_figure).split()) if isinstance(cell, Rate) else set()
            assert expected <= words | {word.rstrip(",") for word in words}, line.title
    assert all(word in words for note in formats.notes(table) for word in note.split())


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StageError, match=r"cannot write table ablation_length to .*file/tables: "):
        formats.write(made("ablation_length", EMPTY), tmp_path / "file/tables")
