"""Task modules are short and free of duplicated code, which belongs in shared modules."""

import ast
from itertools import combinations
from pathlib import Path

from rf_exp.tasks import Task
from tests.conftest import TASKS, read_task

MAX_LINES = 110
REPEATED_LINES = 6  # consecutive equal lines that count as a copy


def source(task: Task) -> Path:
    assert task.module.__file__ is not None
    return Path(task.module.__file__)


def statements(path: Path) -> list[str]:
    """The lines of a file without layout, comments, docstrings and imports."""
    tree = ast.parse(path.read_text("utf-8"))
    skipped: set[int] = set()
    for node in ast.walk(tree):
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and (docstring or isinstance(node, ast.Import | ast.ImportFrom)):
            skipped |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(path.read_text("utf-8").splitlines(), start=1)
    stripped = [line.split("  #")[0].strip() for number, line in lines if number not in skipped]
    return [line for line in stripped if line and not line.startswith("#")]


def line_runs(lines: list[str]) -> set[tuple[str, ...]]:
    return {tuple(lines[at : at + REPEATED_LINES]) for at in range(len(lines) - REPEATED_LINES + 1)}


def test_a_module_is_short(task: Task) -> None:
    assert len(source(task).read_text("utf-8").splitlines()) <= MAX_LINES


def test_no_module_repeats_another() -> None:
    found = {name: line_runs(statements(source(read_task(name)))) for name in TASKS}
    copies = {
        (one, other): sorted(found[one] & found[other])
        for one, other in combinations(found, 2)
        if found[one] & found[other]
    }
    assert not copies


def test_a_copy_is_detected(tmp_path: Path) -> None:
    original = source(read_task("place_food")).read_text("utf-8")
    copy = tmp_path / "copy.py"
    copy.write_text('"""Another task."""\n# a comment\n' + original.replace("\n    ", "\n\n    "))
    assert line_runs(statements(copy)) & line_runs(statements(source(read_task("place_food"))))
