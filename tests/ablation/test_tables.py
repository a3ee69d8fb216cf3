"""From rows to tables: the right denominators, the paper's figures, nothing mixed, nothing hidden."""

import csv
import io
import random
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from rf_exp.ablation import (
    EvaluationRow,
    GenerationRow,
    Results,
    configured,
    formats,
    load,
    page,
    paper,
    wilson,
)
from rf_exp.ablation.suite import CONFIGURED, Suite, TaskFacts
from rf_exp.ablation.tables import TABLES, Column, Length, Rate, Table, Violations, build
from rf_exp.ablation.tables.cells import Figure
from rf_exp.errors import ArgumentError, StageError
from tests.ablation.conftest import BUDGET, evaluation, generation

NAMES = ["tasks", "comparison", "benchmark", "architectures", "shield", "ablation_success", "ablation_length"]
NAMES += ["foreign"]
EMPTY = Results()
SUITE = {
    "lift_barrier": TaskFacts("Lift Barrier", 2, "Two arms lift a barrier.", "It is up.", "1"),
    "take_photo": TaskFacts("Take Photo", 4, "Four arms take a photo.", "It is taken.", "1"),
}


def generated(*rows: list) -> Results:  # type: ignore[type-arg]
    return Results(generation=tuple(row for group in rows for row in group))


def evaluated(*rows: list) -> Results:  # type: ignore[type-arg]
    return Results(evaluation=tuple(row for group in rows for row in group))


def at(table: Table, line: str, column: str) -> Any:
    """The cell of a line and a column, of the kind that the test knows it to be."""
    return table.cell(line, column)


def made(name: str, results: Results, suite: Suite = SUITE) -> Table:
    return TABLES[name](results, suite)


# The paper


def test_the_names_are_the_contract() -> None:
    assert list(TABLES) == NAMES


def test_the_paper_s_averages_follow_from_its_figures() -> None:
    """Guards the figures against a slip of the pen: the printed averages are their rounded means."""
    for agents, averages in paper().averages.items():
        level = [name for name, count in paper().levels.items() if count == agents]
        for demos, average in averages.items():
            mean = sum(paper().baseline[name][demos] for name in level) / len(level)
            assert mean == pytest.approx(average, abs=0.006), (agents, demos)


def test_the_paper_s_tables_agree_where_they_overlap() -> None:
    for task, rate in paper().architectures["separate_local"].items():
        assert rate == paper().baseline[task][150]
    assert list(paper().baseline) == list(paper().levels)
    assert len(paper().levels) == 11


def test_without_rows_every_paper_figure_stands_beside_missing() -> None:
    built = build(EMPTY, configured())
    for name in ("ablation_success", "ablation_length"):
        for row, figures in getattr(paper(), name).items():
            for task, value in figures.items():
                cell = at(built[name], row, task)
                assert (cell.value, cell.paper) == (None, value)
    for task, figures in paper().baseline.items():
        for demos, rate in figures.items():
            assert at(built["benchmark"], task, f"demos_{demos}").paper == rate
            assert at(built["tasks"], task, f"demos_{demos}").paper == rate
    for agents, averages in paper().averages.items():
        for demos, rate in averages.items():
            assert at(built["benchmark"], f"average_{agents}", f"demos_{demos}").paper == rate
    for arch, figures in paper().architectures.items():
        for task, rate in figures.items():
            assert at(built["architectures"], f"{arch}-150", task).paper == rate
    assert [line.title for line in built["comparison"].lines][:-1] == list(paper().comparison)
    assert not any(table.measured for name, table in built.items() if name != "comparison")


# Cells


def test_every_seed_counts_in_the_success_of_generation() -> None:
    table = made("ablation_success", generated(generation("lift_barrier", "logical", 6, 4, loose=2)))
    cell = at(table, "logical", "lift_barrier")
    assert (cell.value, cell.n, cell.paper) == (0.6, 10, 0.802)
    assert cell.success_paper == 0.8
    assert cell.interval == wilson(6, 10).interval


def test_only_successes_count_in_the_length() -> None:
    rows = generation("take_photo", "full", 3, 2, steps=200)
    cell = at(made("ablation_length", generated(rows)), "full", "take_photo")
    assert (cell.value, cell.n, cell.paper) == (201.0, 3, 204)
    half = 4.302653 / 3**0.5  # Student's t for two degrees of freedom, standard deviation 1
    assert cell.interval == pytest.approx((201 - half, 201 + half), abs=1e-5)
    none = at(
        made("ablation_length", generated(generation("take_photo", "full", 0, 4))), "full", "take_photo"
    )
    assert (none.value, none.instead, none.n) == (None, "no success", 0)
    assert none.note == "no success in 4 attempts"
    one = at(made("ablation_length", generated(generation("take_photo", "full", 1, 0))), "full", "take_photo")
    assert (one.value, one.interval) == (100.0, None)


def test_versions_never_share_a_cell() -> None:
    old = generation("lift_barrier", "full", 0, 10, version="9")
    new = generation("lift_barrier", "full", 4, 1, version="10")
    weaker = generation("lift_barrier", "logical", 1, 9, version="9")
    table = made("ablation_success", generated(old, new, weaker))
    cell = at(table, "full", "lift_barrier")
    assert (cell.value, cell.n, cell.version) == (0.8, 5, "10")
    assert cell.note == "criteria version 10; left out: 10 of version 9"
    assert "Lift Barrier: cells of criteria versions 10, 9 cannot be compared." in table.notes
    assert f"logical + spatial + temporal, Lift Barrier: {cell.note}." in formats.notes(table)


def test_another_brain_has_rows_of_its_own() -> None:
    rows = [
        generation("lift_barrier", "full", 5, 0),
        generation("lift_barrier", "full", 1, 4, brain="openai"),
    ]
    table = made("ablation_success", generated(*rows))
    assert at(table, "full", "lift_barrier").value == 1.0
    assert at(table, "full-openai", "lift_barrier").value == 0.2
    assert at(table, "full-openai", "lift_barrier").paper is None


def test_tasks_and_constraints_beyond_the_paper_s_are_shown() -> None:
    table = made("ablation_success", generated(generation("pour_tea", "no_logic", 1, 1)))
    cell = at(table, "no_logic", "pour_tea")
    assert (cell.value, cell.paper) == (0.5, None)
    assert [column.title for column in table.columns if column.kind is Rate] == [
        "Lift Barrier",
        "Three Robots Stack Cube",
        "Take Photo",
        "Pour Tea",
    ]


def test_the_gap_between_rows_comes_with_its_interval() -> None:
    rows = [generation("lift_barrier", "logical", 48, 32), generation("lift_barrier", "full", 56, 14)]
    (note,) = made("ablation_success", generated(*rows)).notes
    assert note == "Lift Barrier, against logical: full +20.0 points [+5.2, +33.4]."  # Newcombe's example


def test_architectures_keep_numbers_of_demonstrations_apart() -> None:
    rows = [
        evaluation("lift_barrier", "shared_local", 50, 1, 9),
        evaluation("lift_barrier", "shared_local", 150, 5, 5),
        evaluation("lift_barrier", "my_arch", 150, 9, 1),
        evaluation("lift_barrier", "shared_local", 150, 0, 10, constraints="logical"),
    ]
    table = made("architectures", evaluated(*rows))
    assert at(table, "shared_local-50", "lift_barrier").value == 0.1
    assert at(table, "shared_local-150", "lift_barrier").value == 0.5
    assert at(table, "shared_local-150", "lift_barrier").paper == 0.04
    assert at(table, "my_arch-150", "lift_barrier").value == 0.9
    assert "10 rollouts of policies that learnt from `logical` data are not in this table." in table.notes


def test_who_was_told_of_the_true_state_is_said() -> None:
    local, told = (
        evaluation("take_photo", arch, 150, 9, 1) for arch in ("separate_local", "separate_coordinated")
    )
    for rows, said in ((local, 0), (local + told, 1)):
        notes = made("architectures", evaluated(rows)).notes
        assert sum("made in the true state of the scene" in note for note in notes) == said


def test_training_seeds_are_pooled_and_named() -> None:
    rows = [evaluation("place_food", "separate_local", 150, n, 10 - n, train_seed=n) for n in (2, 4, 6)]
    cell = at(made("benchmark", evaluated(*rows)), "place_food", "demos_150")
    assert (cell.value, cell.n, cell.note) == (0.4, 30, "3 training seeds together")


def test_an_average_waits_for_every_task_of_its_level() -> None:
    camera = evaluation("camera_alignment", "separate_local", 150, 4, 6)
    stack = evaluation("three_robots_stack_cube", "separate_local", 150, 2, 8)
    partly = at(made("benchmark", evaluated(camera)), "average_3", "demos_150")
    assert (partly.value, partly.note, partly.paper) == (None, "1 of 2 tasks measured", 0.205)
    whole = at(made("benchmark", evaluated(camera, stack)), "average_3", "demos_150")
    assert whole.value == pytest.approx(0.3)


def test_further_numbers_of_demonstrations_get_a_column() -> None:
    table = made("benchmark", evaluated(evaluation("lift_barrier", "separate_local", 20, 1, 1)))
    keys = [column.key for column in table.columns if column.compared]
    assert keys == [f"demos_{n}" for n in (20, 50, 100, 150)]
    assert at(table, "lift_barrier", "demos_20").value == 0.5


# Violations


def followers(table: Table) -> Iterator[tuple[Column, Column]]:
    """(column of success, the column after it); of the tables of the ablation also their lengths."""
    kinds = (Rate, Length) if table.name == "ablation_length" else (Rate,)
    for column, after in zip(table.columns, (*table.columns[1:], Column("end", "")), strict=True):
        if column.kind in kinds:
            yield column, after


@cache
def counted() -> tuple[dict[GenerationRow, int], dict[EvaluationRow, int]]:
    """Rows of everything that a table tells apart, and how many violations each of them had."""
    rng = random.Random(5)
    made: dict[GenerationRow, int] = {}
    rolled: dict[EvaluationRow, int] = {}
    for task in (*paper().levels, "pour_tea"):
        for version in ("1", "2"):
            for constraints in (*paper().ablation_success, "no_logic"):
                for brain in ("scripted", "openai"):
                    some = [rng.choice((0, 0, 1, 2, BUDGET - 1, BUDGET)) for _ in range(7)]
                    rows = generation(task, constraints, 4, 3, brain=brain, version=version, violations=some)
                    made.update(zip(rows, some, strict=True))
            for arch in (*paper().architectures, "my_arch", "foreign"):
                for demos in (20, *paper().demos):
                    for constraints in ("full", "logical"):
                        for shield in (False, True):
                            some = [rng.choice((0, 0, 1, 70)) for _ in range(5)]
                            kind = {"version": version, "constraints": constraints, "shield": shield}
                            runs = evaluation(task, arch, demos, 2, 3, **kind, violations=some)
                            rolled.update(zip(runs, some, strict=True))
    return made, rolled


def by_hand(name: str, line: str, column: str) -> list[int]:
    """The violations behind one cell, picked from all rows of the newest version."""
    made, rolled = counted()
    if name.startswith("ablation") or column == "generated":
        constraints, _, brain = ("full" if column == "generated" else line).partition("-")
        task = line if column == "generated" else column
        wanted = (task, constraints, brain or "scripted", "2")
        return [
            n
            for row, n in made.items()
            if (row.task, row.constraints, row.brain, row.version) == wanted
            and (row.success or name != "ablation_length")
        ]
    shield = name == "shield" and column == "with"
    if name == "shield":
        task, arch, demos, _ = line.split("-")
    elif name == "foreign":
        (task, _, demos, *shielded), arch = line.split("-"), "foreign"
        shield = bool(shielded)
    elif name == "architectures":
        task, (arch, demos) = column, line.split("-")
    else:
        task, arch, demos = line, "separate_local", column.removeprefix("demos_")
    wanted = (task, arch, int(demos), "full", "2", shield)
    return [
        n
        for row, n in rolled.items()
        if (row.task, row.arch, row.demos, row.constraints, row.version, row.shield) == wanted
    ]


@pytest.mark.parametrize("name", NAMES)
def test_beside_every_success_rate_stand_the_violations_of_the_same_rows(name: str) -> None:
    made_rows, rolled = counted()
    table = made(name, Results(tuple(made_rows), tuple(rolled)))
    beside = list(followers(table))
    assert bool(beside) == (name != "comparison")  # which holds texts alone
    for column, after in beside:
        assert (after.key, after.title, after.kind) == (f"{column.key}_violations", "violations", Violations)
        for line in (line for line in table.lines if line.title != "Average"):
            expected = by_hand(name, line.key, column.key)
            cell, figure = at(table, line.key, after.key), at(table, line.key, column.key)
            assert expected and cell.n == figure.n == len(expected)
            assert cell.value == sum(n > 0 for n in expected) / len(expected), (line.key, column.key)
            assert cell.mean_violations == pytest.approx(sum(expected) / len(expected))
            assert cell.interval == wilson(sum(n > 0 for n in expected), len(expected)).interval
            assert (type(cell), cell.version) == (Violations, "2")
    averages = [line for line in table.lines if line.title == "Average"]
    assert len(averages) == (4 if name == "benchmark" else 0)
    for line in averages:
        level = [task for task, agents in paper().levels.items() if line.key == f"average_{agents}"]
        for column, after in beside:
            each = [by_hand(name, task, column.key) for task in level]
            shares = [sum(n > 0 for n in numbers) / len(numbers) for numbers in each]
            cell = at(table, line.key, after.key)
            assert cell.value == pytest.approx(sum(shares) / len(level))
            assert cell.mean_violations == pytest.approx(sum(map(sum, each)) / 5 / len(level))


@pytest.mark.parametrize("name", NAMES)
def test_every_format_shows_the_violations(name: str) -> None:
    made_rows, rolled = counted()
    table = made(name, Results(tuple(made_rows), tuple(rolled)))
    texts = (formats.markdown(table), formats.latex(table), html(table), shown(table))
    for _, after in followers(table):
        for line in table.lines:
            cell = at(table, line.key, after.key)
            assert isinstance(cell.value, float)
            share, average = f"{100 * cell.value:.1f}", f"mean {cell.mean_violations:.2f}"
            assert all(share in text and average in text for text in texts)
    assert all(text.count("violations") >= len(list(followers(table))) for text in texts)
    rows = {(row["row"], row["column"]): row for row in csv.DictReader(io.StringIO(formats.tidy_csv(table)))}
    for column, after in followers(table):
        for line in table.lines:
            row, cell = rows[line.key, after.key], at(table, line.key, after.key)
            assert (row["unit"], row["status"], float(row["value"])) == ("violations", "measured", cell.value)
            assert float(row["mean_violations"]) == cell.mean_violations
            assert int(row["n"]) == int(rows[line.key, column.key]["n"])


def test_a_note_is_told_once_and_violations_are_never_compared() -> None:
    rows = [
        generation("lift_barrier", "full", 5, 5, version="2", violations=(1, 0)),
        generation("lift_barrier", "full", 5, 5, version="1"),
        generation("lift_barrier", "logical", 5, 5, version="2", violations=(3,)),
        generation("take_photo", "full", 1, 1, version="1"),
    ]
    table = made("ablation_success", generated(*rows))
    gap, clean, left_out = formats.notes(table)
    assert gap.startswith("Lift Barrier, against logical: full +0.0 points")
    assert clean.startswith("Lift Barrier without a violation, against logical: full +20.0 points")
    assert left_out == (
        "logical + spatial + temporal, Lift Barrier: criteria version 2; left out: 10 of version 1."
    )


def test_success_without_a_violation_is_counted_beside_success() -> None:
    """Of four successes two needed no repair. Every format shows it as boldly as success and violations."""
    rows = [
        *generation("lift_barrier", "logical", 4, 6, violations=(0, 1, 2, 0, BUDGET)),
        *generation("lift_barrier", "full", 9, 1, violations=(0,) * 9 + (BUDGET,)),
    ]
    table = made("ablation_success", generated(rows))
    cell = at(table, "logical", "lift_barrier")
    assert (cell.value, cell.clean) == (0.4, wilson(2, 10))
    text, tex, drawn = formats.markdown(table), formats.latex(table), html(table)
    for logical in ("**40.0 %**, ", "without a violation **20.0 %** [5.7, 51.0]", "| **60.0 %**, "):
        assert logical in text
    assert "without a violation **90.0 %** [59.6, 98.2]" in text  # also where no success needed a repair
    for value in (
        r"\textbf{40.0 \%}, ",
        r"without a violation \textbf{20.0 \%} [5.7",
        r"& \textbf{60.0 \%}, ",
    ):
        assert value in tex
    assert "<b>40.0 %</b>" in drawn
    assert "<b>20.0 %</b> <span>without a violation</span><small>[5.7, 51.0]" in drawn
    assert "<b>60.0 %</b> <span>violations</span>" in drawn
    styled = shown(table, styled=True)
    assert all(f"\x1b[1m{value}" in styled for value in ("40.0 %", "20.0 %", "60.0 %"))
    (line,) = [
        row
        for row in csv.DictReader(io.StringIO(formats.tidy_csv(table)))
        if (row["row"], row["column"]) == ("logical", "lift_barrier")
    ]
    assert (float(line["clean"]), float(line["clean_low"])) == (0.2, wilson(2, 10).low)


def test_without_a_success_there_are_no_violations_on_the_way_to_one() -> None:
    rows = generation("take_photo", "full", 0, 4, violations=(BUDGET,))
    built = build(generated(rows), SUITE)
    assert at(built["ablation_length"], "full", "take_photo_violations").instead == "no success"
    cell = at(built["ablation_success"], "full", "take_photo_violations")
    assert (cell.value, cell.mean_violations) == (1.0, BUDGET)


# The suite


def test_every_configured_task_is_shown_in_the_words_of_its_file() -> None:
    table = build(EMPTY, configured())["tasks"]
    paths = sorted(CONFIGURED.glob("*.yaml"))
    assert paths and {path.stem for path in paths} == set(configured())
    for path in paths:
        node = yaml.safe_load(path.read_text("utf-8"))[path.stem]
        words = (len(node["robots"]), node["title"], node["description"], node["target_condition"])
        columns = ("agents", "description", "condition")
        agents, description, condition = (at(table, path.stem, column).value for column in columns)
        (title,) = (line.title for line in table.lines if line.key == path.stem)
        assert (int(str(agents)), title, description, condition) == words
        assert at(table, path.stem, "criteria").value


def test_a_task_of_one_s_own_comes_after_the_paper_s() -> None:
    own = {**SUITE, "pour_tea": TaskFacts("Tea, Poured", 1, "An arm pours.", "The cup is full.", "3")}
    table = made("tasks", EMPTY, own)
    assert [line.key for line in table.lines] == [*paper().levels, "pour_tea"]
    cells = [at(table, "pour_tea", key).value for key in ("agents", "criteria", "description", "condition")]
    assert cells == ["1", "3", "An arm pours.", "The cup is full."]
    baseline = made("benchmark", EMPTY, own)
    assert (baseline.lines[-1].key, baseline.lines[-1].title) == ("pour_tea", "Tea, Poured")
    assert at(baseline, "average_1", "demos_150").paper == 0.49


def test_tasks_of_the_paper_that_are_not_configured_are_named() -> None:
    (note,) = made("tasks", EMPTY, {name: SUITE["lift_barrier"] for name in list(paper().levels)[:-1]}).notes
    assert note == "Tasks of the paper without a configuration: Long Pipeline Delivery."


def test_comparison_derives_its_own_row_from_the_tasks() -> None:
    def here(suite: Suite) -> list[object]:
        table = made("comparison", EMPTY, suite)
        return [at(table, "This suite", key).value for key in ("single", "multi", "level")]

    alone = TaskFacts("Pick", 1, "", "", "1")
    assert here(SUITE) == ["no", "yes", "Plan & Control"]
    assert here({"pick": alone}) == ["yes", "no", "Plan & Control"]
    assert here({**SUITE, "pick": alone}) == ["yes", "yes", "Plan & Control"]
    assert made("comparison", EMPTY).caption.endswith("2 tasks, by number of agents: 1 with 2, 1 with 4.")


def test_a_cell_that_does_not_exist_is_named() -> None:
    table = made("ablation_length", EMPTY)
    with pytest.raises(
        ArgumentError, match=r"unknown row of table ablation_length 'none'; available: full, log"
    ):
        table.cell("none", "lift_barrier")
    with pytest.raises(
        ArgumentError, match=r"unknown column of table ablation_length 'x'; available: lift_bar"
    ):
        table.cell("full", "x")


# Files and the terminal


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


def html(table: Table) -> str:
    """The table on a page."""
    section = page.Section(table.name, table.title, table=page.laid(table))
    return page.document("A page", "a paper", [section])


def shown(table: Table, styled: bool = False) -> str:
    """The table on a terminal of 80 columns."""
    terminal = io.StringIO()
    formats.show(
        table,
        Console(file=terminal, width=80, force_terminal=styled, color_system="standard" if styled else None),
    )
    return terminal.getvalue()


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
            told = set(line.title.split()) | set(table.columns[index].title.split())
            for place in (index, *([] if after is None else [after])):
                cell = line.cells[place]
                assert isinstance(cell, Figure)
                told |= set(" ".join([cell.figure, *cell.details]).split())
                told |= set(" ".join(cell.clean_figure).split()) if isinstance(cell, Rate) else set()
            assert told <= words | {word.rstrip(",") for word in words}, line.title
    assert all(word in words for note in formats.notes(table) for word in note.split())


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StageError, match=r"cannot write table ablation_length to .*file/tables: "):
        formats.write(made("ablation_length", EMPTY), tmp_path / "file/tables")


# The shield


def shielded_rows() -> Results:
    """15 scenes of one policy, 10 of them also with a shield, and a policy that was only shielded."""
    without = evaluation("lift_barrier", "separate_local", 150, 6, 9, violations=(4, 0), contacts=2)
    with_it = evaluation("lift_barrier", "separate_local", 150, 8, 2, shield=True, interventions=7)
    alone = evaluation("take_photo", "shared_local", 50, 1, 1, shield=True)
    return evaluated(without, with_it, alone)


def test_a_shield_is_compared_over_the_same_scenes() -> None:
    table = made("shield", shielded_rows())
    assert [line.key for line in table.lines] == [
        "lift_barrier-separate_local-150-paper",
        "take_photo-shared_local-50-paper",
    ]
    line = table.lines[0].key
    for column, value, many in (
        ("without", 0.6, None),
        ("with", 0.8, None),
        ("without_violations", 0.5, 2.0),
        ("with_violations", 0.0, 0.0),
        ("without_contacts", 1.0, 2.0),
        ("with_contacts", 0.0, 0.0),
        ("interventions", 1.0, 7.0),
    ):
        cell = at(table, line, column)
        assert (cell.value, cell.n) == (value, 10), column
        assert cell.mean_violations == many if isinstance(cell, Violations) else many is None
        assert cell.interval is not None
    gap = "Lift Barrier, separate_local, 150 demos, paper, against without: with +20.0 points ["
    assert any(note.startswith(gap) for note in table.notes)
    only = table.lines[1].key
    assert (at(table, only, "without").value, at(table, only, "with").value) == (None, 0.5)


def test_without_a_shielded_rollout_the_table_is_empty() -> None:
    assert made("shield", evaluated(evaluation("lift_barrier", "separate_local", 150, 6, 9))).lines == ()


@pytest.mark.parametrize("name", ["tasks", "benchmark", "architectures"])
def test_other_tables_leave_shielded_rollouts_out_and_say_so(name: str) -> None:
    results = shielded_rows()
    rest = Results(evaluation=tuple(row for row in results.evaluation if not row.shield))
    table, plain = made(name, results), made(name, rest)
    assert table.lines == plain.lines
    note = "12 shielded rollouts are in a table of their own, `shield`."
    assert note in table.notes and note not in plain.notes


def test_recipes_have_lines_of_their_own_and_the_oracle_comes_last() -> None:
    of_paper = evaluation("lift_barrier", "separate_local", 150, 2, 4)
    ours = evaluation("lift_barrier", "separate_local", 150, 9, 1, recipe="fast", core_s=90.0)
    ours = [*ours, *evaluation("take_photo", "separate_local", 50, 1, 1, recipe="fast", core_s=60.0)]
    told = evaluation("lift_barrier", "separate_local", 150, 30, 0, recipe="state", observation="state")
    table = build(evaluated(of_paper, ours, told), SUITE)["benchmark"]
    lines = {line.key: line for line in table.lines}
    rates = {
        key: (lines[key].cells[1].value, at(table, key, "demos_150").value)
        for key in lines
        if key.startswith("lift_barrier")
    }
    assert rates == {
        "lift_barrier": ("fast", 0.9),
        "lift_barrier-paper": ("paper", 2 / 6),
        "lift_barrier-state": ("state", 1.0),
    }
    assert at(table, "lift_barrier", "core_minutes").value == "1.5"
    assert at(table, "lift_barrier-state", "core_minutes").value == ""
    assert "Policies of recipe state are told the true poses of all things: an oracle." in table.notes
    shown = made("architectures", evaluated(of_paper, ours, told))
    assert [(line.key, line.cells[1].value) for line in shown.lines if "separate_local" in line.key] == [
        ("separate_local-50", "fast"),
        ("separate_local-150", "fast"),
        ("separate_local-150-paper", "paper"),
        ("separate_local-150-state", "state"),
    ]


def test_disturbed_seeds_measure_no_expert_and_are_counted_apart() -> None:
    good = generation("lift_barrier", "full", 10, 0)
    bad = [replace(row, disturbance_rad=0.05) for row in generation("lift_barrier", "full", 1, 9)]
    learnt = evaluation("take_photo", "separate_local", 150, 1, 1, recipe="fast", disturbance_rad=0.05)
    both, plain = (
        build(Results(generation=rows, evaluation=tuple(learnt)), SUITE)
        for rows in ((*good, *bad), tuple(good))
    )
    assert both["ablation_success"].lines == plain["ablation_success"].lines
    cells = [at(both["tasks"], "lift_barrier", key).value for key in ("generated", "disturbed")]
    assert cells == [1.0, 0.1]
    assert "disturbed" not in {column.key for column in plain["tasks"].columns}
    said = "Recipe fast learns from demonstrations whose execution was disturbed, by 0.05 rad."
    for name, table in both.items():
        assert table.notes[-1] == said, name
        assert table.notes[-2].startswith("10 seeds of disturbed demonstrations do not measure the expert")


def test_policies_of_others_count_in_no_table_of_ours() -> None:
    """Though they have more rows, and are called as a recipe of ours is."""
    ours = evaluation("lift_barrier", "separate_local", 150, 9, 1, recipe="fast")
    others = evaluation("lift_barrier", "foreign", 0, 40, 10, recipe="fast", violations=(3,))
    alone, beside = build(evaluated(ours), SUITE), build(evaluated(ours, others), SUITE)
    assert {name: table for name, table in beside.items() if name != "foreign"} == {
        name: table for name, table in alone.items() if name != "foreign"
    }
    assert alone["foreign"].lines == ()
    (line,) = beside["foreign"].lines
    assert (line.key, line.title) == ("lift_barrier-fast-0", "Lift Barrier, fast")
    cell = at(beside["foreign"], line.key, "success")
    assert (cell.value, cell.interval) == (0.8, wilson(40, 50).interval)
    assert at(beside["foreign"], line.key, "success_violations").value == 1.0
