"""The tutorial works as docs/adding_a_task.md says, without any edit of the package or of conf/."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M
from rf_exp.laws import LAWS
from rf_exp.robots import DEFAULT
from rf_exp.stages import Cell
from rf_exp.store import Store
from rf_exp.tasks import TABLE_CENTRE_M, TABLE_M
from rf_exp.types import ConstraintSet
from tests.conftest import TASKS, experiment, read_task

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.mark.slow
def test_a_task_outside_of_the_package_is_generated(tmp_path: Path) -> None:
    run = subprocess.run(
        [
            *(sys.executable, "-m", "rf_exp.run", f"hydra.searchpath=[file://{HERE / 'conf'}]"),
            *("task=push_button", "stages=[generate,report]", "render=false", "episodes=5", "recordings=0"),
            *("workers=1", f"out={tmp_path}"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    path = tmp_path / "results/generate/push_button/full-disturbed.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [row["seed"] for row in rows] == list(range(5))
    assert all(row["success"] and row["success_paper"] for row in rows), rows
    store = Store.open(tmp_path / "data/push_button/full/fast.zarr")
    assert len(store) == 5 and store.steps == sum(row["steps"] for row in rows)
    assert "Push Button" in (tmp_path / "tables/tasks.md").read_text()


@pytest.mark.slow
def test_the_laws_are_applied_to_a_task_outside_of_the_package(tmp_path: Path) -> None:
    """All laws hold but one, as the document says."""
    run = subprocess.run(
        [
            *(sys.executable, "-m", "rf_exp.laws", f"hydra.searchpath=[file://{HERE / 'conf'}]"),
            *("task=push_button", "render=false", f"out={tmp_path}"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    lines = [line for line in run.stdout.splitlines() if line.startswith("push_button: ")]
    assert len(lines) == sum(not law.pictures for law in LAWS), run.stdout + run.stderr
    (broken,) = (line.split(": ", 2)[2] for line in lines if not line.endswith(": holds"))
    assert run.returncode == 1
    text = (ROOT / "docs/adding_a_task.md").read_text("utf-8")
    assert f'"{broken}"' in " ".join(text.split())


def test_the_document_shows_the_files_as_they_are() -> None:
    text = (ROOT / "docs/adding_a_task.md").read_text("utf-8")
    quoted = dict(
        re.findall(r"^`(tests/tutorial/\S+)`:\n\n```\w+\n(.*?)```$", text, re.MULTILINE | re.DOTALL)
    )
    assert set(quoted) == {
        "tests/tutorial/conf/task/push_button.yaml",
        "tests/tutorial/button.py",
        "tests/tutorial/push_button.py",
    }
    for path, content in quoted.items():
        assert content == (ROOT / path).read_text("utf-8"), path


def test_the_figures_of_the_document_are_those_of_the_code() -> None:
    text = (ROOT / "docs/adding_a_task.md").read_text("utf-8").replace("\n  ", " ")
    (x, y, _), (cx, cy) = TABLE_M, TABLE_CENTRE_M
    across = f"from x = {cx - x / 2:g} to {cx + x / 2:g} m and from y = {cy - y / 2:g} to {cy + y / 2:g} m"
    rest = ", ".join(f"{angle:.3f}".removesuffix(".000") for angle in DEFAULT.rest_rad)
    tasks = [read_task(name) for name in TASKS]
    nearest_m = min(
        np.hypot(robot.x_m - other.x_m, robot.y_m - other.y_m)
        for task in tasks
        for robot, other in combinations(task.robots, 2)
    )
    for figure in (
        f"top is {x:g} x {y:g} m, {across}",
        f"without it `[{rest}]`",
        f"two arms must be more than {100 * AGENT_MARGIN_M:g} cm apart",
        f"an arm more than {1000 * OBJECT_MARGIN_M:g} mm from every object",
        f"no two bases are nearer than {nearest_m:g} m",
        f"Fingers open to {200 * DEFAULT.hand.open_m:g} cm",
    ):
        assert figure in text, figure


def test_the_document_names_the_rows_that_the_command_writes() -> None:
    text = (ROOT / "docs/adding_a_task.md").read_text("utf-8")
    disturbs = experiment("task=pick_meat")
    for each in (disturbs, replace(disturbs, disturbance_rad=0.0, delay_s=0.0)):
        path = Cell(each, each.tasks[0], ConstraintSet("full")).generation_path
        assert f"`{path}`".replace("pick_meat", "push_button") in text or f"(`{path.name}`" in text
