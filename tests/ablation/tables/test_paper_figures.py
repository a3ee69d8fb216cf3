"""The figures of the paper, which are shown beside ours."""

import pytest

from rf_exp.ablation import configured, paper
from rf_exp.ablation.tables import TABLES, build
from tests.ablation.tables.making import EMPTY, NAMES, at


def test_the_names_of_tables_are_fixed() -> None:
    assert list(TABLES) == NAMES


def test_the_paper_s_averages_follow_from_its_figures() -> None:
    """Guards the figures against typing errors: the printed averages are their rounded means."""
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


def test_without_rows_every_paper_figure_is_beside_missing() -> None:
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
