"""Strict reading of task configurations; errors name the problem."""

import os
import subprocess
import sys
from copy import deepcopy
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from rf_exp.artifacts import plain
from rf_exp.errors import ArgumentError
from rf_exp.store import Store
from rf_exp.tasks import Task, load_task, read_task, stored_task
from tests.conftest import CONF


@pytest.fixture
def node() -> dict[str, Any]:
    loaded = OmegaConf.to_container(OmegaConf.load(CONF / "task" / "place_food.yaml"))
    assert isinstance(loaded, dict)
    return deepcopy(loaded["place_food"])


def message(node: dict[str, Any]) -> str:
    with pytest.raises(ArgumentError) as error:
        load_task("place_food", node)
    return str(error.value)


def test_the_file_becomes_a_task(node: dict[str, Any]) -> None:
    task = load_task("place_food", node)
    assert task.agents == (1, 2) and list(task.objects) == ["pot", "lid", "steak"]
    assert task.objects["lid"].relative_to == "pot"
    assert task.robots[0].y_m == -0.75 and isinstance(task.robots, tuple)


def test_an_unknown_field(node: dict[str, Any]) -> None:
    node["robot"] = []
    assert message(node) == "task 'place_food': unknown field robot"


def test_a_missing_field(node: dict[str, Any]) -> None:
    del node["objects"]["pot"]["asset"]
    assert message(node) == "task 'place_food': field objects.asset is missing"


def test_a_field_of_another_type(node: dict[str, Any]) -> None:
    node["title"] = 3
    assert message(node) == "task 'place_food': field title is 3; expected <class 'str'>"


def test_an_object_that_may_start_beyond_the_edge_of_the_table(node: dict[str, Any]) -> None:
    """The table ends at x = 1.4 m; the position of the lid is relative to the pot."""
    node["objects"]["pot"]["x_m"] = [0.0, 1.35]
    error = message(node)
    assert error.startswith("task 'place_food': object 'pot' may start ")
    assert error.endswith(" mm beyond the table's edge at x = 1.4 m and fall; narrow its ranges")
    assert 20 < float(error.split("may start ")[1].split(" mm")[0]) < 100


def test_an_object_that_is_sampled_beyond_the_edge_of_the_table(node: dict[str, Any]) -> None:
    """A position relative to another object is known only after sampling that object."""
    node["objects"]["steak"]["y_m"] = [-1.6, -1.6]
    task = load_task("place_food", node)
    with pytest.raises(
        ArgumentError, match=r"seed 7: steak would start 1\d\d mm beyond the table's edge at y = -1.4 m"
    ):
        task.start(7)


def test_objects_without_space_are_named_with_their_overlap(node: dict[str, Any]) -> None:
    node["objects"]["steak"] |= {"y_m": [-0.05, -0.05], "x_m": [0.0, 0.0]}
    task = load_task("place_food", node)
    with pytest.raises(
        ArgumentError, match=r"in the last pot and steak overlap by [1-9]\d* mm; widen their ranges"
    ):
        task.start(0)


@pytest.mark.slow
def test_every_start_of_the_suite_lies_on_the_table(task: Task) -> None:
    for seed in range(200):
        task.start(seed)


def test_a_range_the_wrong_way_round(node: dict[str, Any]) -> None:
    node["objects"]["pot"]["x_m"] = [0.1, -0.1]
    assert "task 'place_food': x_m of asset 'pot': range [0.1, -0.1] is the wrong way round" in message(node)


def test_an_asset_that_does_not_exist(node: dict[str, Any]) -> None:
    node["objects"]["steak"]["asset"] = "tofu"
    assert message(node).startswith(
        "task 'place_food': object 'steak': unknown asset 'tofu'; available: barrier"
    )


def test_an_object_relative_to_nothing(node: dict[str, Any]) -> None:
    node["objects"]["lid"]["relative_to"] = "pan"
    assert message(node) == (
        "task 'place_food': object 'lid' is relative to 'pan'; expected one listed before it: ['pot']"
    )


def test_a_randomisation_out_of_range(node: dict[str, Any]) -> None:
    node["randomisation"] = {"mass_scale": 1.5}
    assert "randomisation.mass_scale is 1.5; expected a number from 0 to 1" in message(node)


def test_a_name_that_differs_from_the_file(node: dict[str, Any]) -> None:
    node["name"] = "put_food"
    assert message(node) == "task 'place_food': field name is 'put_food'; expected 'place_food'"


def test_a_global_camera_on_a_wrist(node: dict[str, Any]) -> None:
    node["cameras"]["global"]["mount"] = "wrist"
    assert message(node) == (
        "task 'place_food': camera 'global' has mount 'wrist'; expected 'world': it belongs to no arm"
    )


TRAP = "import pathlib; pathlib.Path(__file__).with_name('sprung').touch()\nraise SystemExit(7)\n"


def hostile_identities(module: str) -> list[dict[str, Any]]:
    """Attributes of a store with which an attacker tries to have a module imported."""
    task = read_task(CONF / "task" / "lift_barrier.yaml")
    fields_of_task = {each.name: getattr(task, each.name) for each in fields(task)}
    scene = plain({**fields_of_task, "robots": task.identity["robots"]})
    asset = {**scene, "objects": {"barrier": {**scene["objects"]["barrier"], "asset": f"{module}.asset"}}}
    return [
        {"task": "lift_barrier", "scene": {**scene, "code": module}},
        {"task": "lift_barrier", "scene": asset},
        {"task": module, "scene": {**scene, "name": module}},
        {"task": f"../../{module}", "scene": {**scene, "name": f"../../{module}"}},
        {"task": f"assets.{module}", "scene": scene},
        {"task": ["lift_barrier"], "scene": None},
        {"scene": {**scene, "code": module}},
    ]


def test_attributes_of_a_store_import_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An importable module with side effects; the attributes name it in every possible place."""
    (tmp_path / "trap.py").write_text(TRAP)
    monkeypatch.syspath_prepend(tmp_path)
    for identity in hostile_identities("trap"):
        with pytest.raises(ArgumentError, match=r"of a store|of another configuration"):
            stored_task(identity)
    assert "trap" not in sys.modules and not (tmp_path / "sprung").exists()


def test_the_task_of_a_store_is_the_configured_one(tmp_path: Path, node: dict[str, Any]) -> None:
    task = load_task("place_food", node)
    identity = {"task": "place_food", "scene": plain(task.identity)}
    assert stored_task(identity) == task
    node["success"]["level_deg"] = 80.0
    OmegaConf.save({"place_food": node}, tmp_path / "place_food.yaml")
    with pytest.raises(ArgumentError, match=r"another configuration of place_food .* it differs in success"):
        stored_task(identity, tmp_path)
    changed = read_task(tmp_path / "place_food.yaml")
    assert stored_task({"task": "place_food", "scene": plain(changed.identity)}, tmp_path) == changed


@pytest.mark.slow
def test_replay_of_a_hostile_store_imports_nothing(tmp_path: Path) -> None:
    (tmp_path / "trap.py").write_text(TRAP)
    for number, identity in enumerate(hostile_identities("trap")[:3]):
        Store.create(tmp_path / f"data/{number}.zarr", identity, 2, [], 0, 0).close()
    command = [sys.executable, str(CONF.parent / "benchmarks" / "replay.py"), str(tmp_path / "data")]
    path = os.pathsep.join([str(tmp_path), str(CONF.parent), os.environ.get("PYTHONPATH", "")])
    process = subprocess.run(
        command,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert process.returncode == 1 and "of another configuration of lift_barrier" in process.stderr
    assert not (tmp_path / "sprung").exists()
