"""A task's configuration is read strictly; what is wrong is named."""

from copy import deepcopy
from typing import Any

import pytest
from omegaconf import OmegaConf

from rf_exp.errors import ArgumentError
from rf_exp.tasks.configuration import load_task
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
    node["randomisation"] = {"heavy": 1.5}
    assert "randomisation.heavy is 1.5; expected a number from 0 to 1" in message(node)


def test_a_name_that_is_not_the_files(node: dict[str, Any]) -> None:
    node["name"] = "put_food"
    assert message(node) == "task 'place_food': field name is 'put_food'; expected 'place_food'"


def test_a_global_camera_on_a_wrist(node: dict[str, Any]) -> None:
    node["cameras"]["global"]["mount"] = "wrist"
    assert message(node) == (
        "task 'place_food': camera 'global' has mount 'wrist'; expected 'world': it belongs to no arm"
    )
