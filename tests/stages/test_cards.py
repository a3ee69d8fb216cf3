"""Data card and summary of a store after generation: every value."""

import json
import sys
from dataclasses import replace
from html import unescape
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from rf_exp.artifacts import code_version
from rf_exp.command import run_guarded
from rf_exp.data.__main__ import main
from rf_exp.datagen import generator_version
from rf_exp.stages import Cell, generate_data
from rf_exp.stages.generation import _store
from rf_exp.store import Store, facts
from rf_exp.tasks import Task
from tests.conftest import cell_of, experiment

CONFIGURED = experiment("constraints=all")


def card_values(card: str) -> dict[str, str]:
    """The rows of the card's table."""
    rows = (line.strip("|").split("|") for line in card.splitlines() if line.startswith("| "))
    return {name.strip(): value.strip() for name, value in rows}


def unmarked(values: dict[str, Any]) -> dict[str, Any]:
    """The values without marks of Markdown."""
    return {
        name: value.replace("`", "") if isinstance(value, str) else value for name, value in values.items()
    }


@pytest.mark.slow
def test_no_value_of_a_new_store_is_empty(lift_barrier: Task, tmp_path: Path) -> None:
    for row in CONFIGURED.constraint_sets:
        with _store(Cell(replace(CONFIGURED, out=tmp_path), lift_barrier, row)) as store:
            values = facts(store)
        assert all(str(value) for value in values.values()), values
        assert values["constraints"] == row.name


@pytest.mark.slow
def test_every_value_is_what_the_store_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    configured = experiment(
        *("task=pick_meat", "constraints=logical_temporal", "stages=[generate]", "episodes=1"),
        *("render=false", "recordings=0", "wandb=disabled", f"out={tmp_path}"),
    )
    task, path = configured.tasks[0], cell_of(configured).data_path
    generate_data(cell_of(configured))
    store, card = Store.open(path), unescape(path.with_suffix(".md").read_text())
    wanted = {
        "task": "pick_meat",
        "constraints": "logical_temporal",
        "robots": "1 x Franka Panda with its gripper, in simulation (ManiSkill 3, SAPIEN)",
        "episodes": 1,
        "steps": store.steps,
        "steps an episode": f"{store.steps} to {store.steps}",
        "control rate": "20 Hz",
        "minutes of motion": round(store.steps / 20 / 60, 2),
        "scene seeds": "0 to 0",
        "cameras": "none",
        "pictures": "none",
        "depth, segmentation": "none",
        "objects": ", ".join(task.objects),
        "disturbed": "yes: executed differs from action",
    }
    assert unmarked(facts(store)) == wanted
    rows = unmarked(card_values(card))
    assert rows.pop("what") == "value" and rows.pop("---") == "---"
    assert rows == {name: str(value) for name, value in wanted.items()}
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["rf_exp.data", "summary", str(path), "--json"])
    assert run_guarded(main) == 0
    summary = json.loads(capsys.readouterr().out)[str(path)]
    assert summary.pop("MiB") > 0 and unmarked(summary) == wanted
    success = [
        line.removeprefix("- ") for line in card.split("## Success")[1].splitlines() if line[:2] == "- "
    ]
    assert store.description is not None and success == list(store.description.conditions)
    for part in (
        f"# {task.title}: demonstrations of several arms",
        f"`{path.name}` is a Zarr 3 store",
        f"{task.description} {task.target_condition}",
        f"of version {task.version}; all of them held for {task.success['hold_steps']:g} control steps",
        f"Generator {generator_version(task)}, code {code_version()}; python ",
        f"numpy {metadata.version('numpy')}",
        '"name": "logical_temporal"',
    ):
        assert part in card, part
