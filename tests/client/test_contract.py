"""The contract for foreign policies matches the observations and actions of the suite."""

from typing import Any

import numpy as np
import pytest

from rf_exp.client import Contract, validate_chunk
from rf_exp.envs.observations import observation_space
from rf_exp.errors import ArgumentError
from rf_exp.observations import Observations
from rf_exp.tasks import Task
from tests.client.suite import FILE, VELOCITY_RAD_S, suite_json
from tests.conftest import CONF, TASKS, read_task

OPTIONS: list[dict[str, Any]] = [
    {"state": "joints", "pictures": True, "language": True},
    {"state": "full", "pictures": False, "language": False},
    {"state": "full", "pictures": True, "depth": True, "calibration": True, "width": 64, "height": 48},
    {"state": "none", "pictures": False, "segmentation": True, "cameras": "local"},
    {"state": "none", "depth": True, "pictures": False, "calibration": True, "cameras": "global"},
]


@pytest.mark.slow
def test_the_clients_description_of_the_suite_is_current() -> None:
    assert FILE.read_text("utf-8") == suite_json(), "write it again: python -m tests.client.suite"
    assert f"limits: {{velocity_rad_s: {VELOCITY_RAD_S}," in (CONF / "config.yaml").read_text("utf-8")


def test_the_contract_describes_observations_of_the_environments(task: Task) -> None:
    for options in OPTIONS:
        space = observation_space(Observations(**{"language": False, **options}), task)
        contract = Contract.of_task(task.name, **{"language": False, **options})
        assert contract.entries.keys() == space.spaces.keys(), options
        observation = contract.synthetic_observation(3)
        for key, (shape, dtype, _) in contract.entries.items():
            assert space[key].contains(observation[key]), key
            if dtype != "str":
                assert (shape, np.dtype(dtype)) == (space[key].shape, space[key].dtype), key


def test_fields_accept_the_values_of_the_suite() -> None:
    invalid: list[dict[str, Any]] = [{"state": "some"}, {"cameras": "left"}, {"width": 0}]
    for field in invalid:
        with pytest.raises(ValueError, match=next(iter(field))):
            Contract(2, **field)
        with pytest.raises(ArgumentError):
            Observations(pictures=True, **field)
    with pytest.raises(ValueError, match="arms is 0"):
        Contract(0)
    with pytest.raises(ValueError, match=f"unknown task 'juggle'; available: {', '.join(TASKS)}"):
        Contract.of_task("juggle")


def test_a_contract_may_have_any_number_of_arms() -> None:
    entries = Contract(5, ("ball",), state="full", calibration=True).entries
    assert entries["qpos"].shape == (5, 9) and entries["world_from_base"].shape == (5, 4, 4)
    assert {"rgb_global", "rgb_agent5", "pose_ball"} <= entries.keys() and "rgb_agent6" not in entries


def test_both_shapes_of_a_chunk_are_accepted() -> None:
    chunk = np.random.default_rng(0).normal(size=(4, 3, 8))
    np.testing.assert_array_equal(validate_chunk(chunk, 3), chunk)
    np.testing.assert_array_equal(validate_chunk(chunk.reshape(4, 24).tolist(), 3), chunk)
    with pytest.raises(ValueError, match=r"shape \(4, 3, 8\); expected finite numbers \(T, 2, 8\)"):
        validate_chunk(chunk, 2)


def test_a_task_of_the_suite_is_known_by_its_name() -> None:
    contract, task = Contract.of_task("take_photo"), read_task("take_photo")
    assert contract.arms == len(task.agents) and contract.description == task.description
