"""The tutorial works as docs/adding_a_task.md says: nothing of the package or of conf/ is touched for it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rf_exp.store import Store

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


def test_the_document_shows_the_files_as_they_are() -> None:
    text = (ROOT / "docs/adding_a_task.md").read_text("utf-8")
    shown = dict(re.findall(r"^`(tests/tutorial/\S+)`:\n\n```\w+\n(.*?)```$", text, re.MULTILINE | re.DOTALL))
    assert set(shown) == {
        "tests/tutorial/conf/task/push_button.yaml",
        "tests/tutorial/button.py",
        "tests/tutorial/push_button.py",
    }
    for path, content in shown.items():
        assert content == (ROOT / path).read_text("utf-8"), path
