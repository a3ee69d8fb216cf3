"""Scenes without a simulator, made from the start of an episode."""

import numpy as np

from rf_exp.datagen import Planner, Settings
from rf_exp.datagen.brain import FaultySpec, Question
from rf_exp.findings import Violation
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet, Scene


def start_scene(task: Task, seed: int) -> Scene:
    """The scene of a seed before anything has moved."""
    return task.start(seed).scene


def rejection(task: Task, fault: str) -> Violation:
    """What RoboChecker finds wrong with the plan of seed 0 that has a fault in it, before anything moves."""
    settings, scene = (
        Settings.configured(task, ConstraintSet("full"), FaultySpec(fault)),
        start_scene(task, 0),
    )
    planner = Planner(settings, settings.make_brain(0))
    found = planner.plan(Question(task, scene, {}), scene, np.random.default_rng(0))
    assert isinstance(found, Violation)
    return found
