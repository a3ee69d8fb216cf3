"""Occupied places are reported before motion planning, with the object and the overlap in mm."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from rf_exp.datagen import Planner, Settings
from rf_exp.datagen.brain import Question, ScriptedSpec
from rf_exp.datagen.obstacles import occupied_place
from rf_exp.datagen.yielding import yielding_agents
from rf_exp.findings import Finding, Violation
from rf_exp.statements import Proposal
from rf_exp.tasks import Task, load_task
from rf_exp.types import ConstraintSet, Subgoal
from tests.conftest import CONF
from tests.scenes import start_scene

LID_OFF = (
    Subgoal(2, "grasp", "lid", "knob"),
    Subgoal(2, "lift", "lid", height_m=0.12),
    Subgoal(2, "place", "lid", target="aside"),
)


def place_food(**objects: Any) -> Task:
    """Place Food with additional objects on the table."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / "place_food.yaml"))
    config = deepcopy(node["place_food"])
    config["objects"] |= objects
    return load_task("place_food", config)


def test_nothing_overlaps_in_the_plans_of_the_suite(task: Task) -> None:
    for seed in range(20):
        scene = start_scene(task, seed)
        assert occupied_place(task, task.module.plan(scene, task), scene) is None


@pytest.mark.slow
def test_an_occupied_place_is_refused_before_planning() -> None:
    task = place_food(block={"asset": "steak", "relative_to": "pot", "x_m": 0.0, "y_m": 0.27})
    scene = start_scene(task, 0)
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    planner = Planner(settings, settings.make_brain(0))
    found = planner.plan(Question(task, scene, {}), scene, np.random.default_rng(0))
    assert isinstance(found, Violation)
    assert found.finding is Finding.TAKEN
    assert found.sentence == (
        f"Agent_2 cannot place lid to aside: lid would overlap block there by {-1000 * found.value:.0f} mm; "
        "move one of them"
    )
    assert 0.001 < -found.value < 0.05
    assert yielding_agents(found, Proposal(LID_OFF, ()), task, scene) == []


def test_two_objects_on_one_place_overlap() -> None:
    task = place_food()
    proposal = Proposal(
        (*LID_OFF, Subgoal(1, "grasp", "steak", "center"), Subgoal(1, "place", "steak", target="aside")), ()
    )
    found = occupied_place(task, proposal, start_scene(task, 0))
    assert found is not None
    assert "lid would overlap steak at aside there by " in found.sentence


def test_an_object_that_is_moved_away_frees_its_place() -> None:
    """Judged without planned motion."""
    task = place_food(block={"asset": "steak", "relative_to": "pot", "x_m": 0.0, "y_m": 0.27})
    scene = start_scene(task, 0)
    moved = Proposal((*LID_OFF, Subgoal(1, "grasp", "block", "center")), ())
    assert occupied_place(task, Proposal(LID_OFF, ()), scene) is not None
    assert occupied_place(task, moved, scene) is None
