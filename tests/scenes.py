"""Scenes at the start of an episode, without a simulator."""

import numpy as np

from rf_exp.datagen import Planner, Settings
from rf_exp.datagen.brain import FaultySpec, Question
from rf_exp.findings import Violation
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet, Scene


def start_scene(task: Task, seed: int) -> Scene:
    """The scene of a seed before the first step."""
    return task.start(seed).scene


def rejection(task: Task, fault: str) -> Violation:
    """RoboChecker's violation for the plan of seed 0 with this fault, before the first step."""
    settings, scene = (
        Settings.configured(task, ConstraintSet("full"), FaultySpec(fault)),
        start_scene(task, 0),
    )
    planner = Planner(settings, settings.make_brain(0))
    violation = planner.plan(Question(task, scene, {}), scene, np.random.default_rng(0))
    assert isinstance(violation, Violation)
    return violation
