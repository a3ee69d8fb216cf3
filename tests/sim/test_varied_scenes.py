"""Clutter and objects of other sizes in simulation: they are bodies, rest, and report contacts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rf_exp.datagen import EpisodeGenerator, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.sim import Simulator
from rf_exp.tasks import Ledger, SuccessEvaluator, Task, label_images, read_variation
from rf_exp.types import ConstraintSet
from tests.conftest import read_task

SEED = 3


def task_with(name: str, variation: str, **changes) -> Task:
    return replace(read_task(name), variation=replace(read_variation(variation), **changes))


@pytest.mark.slow
@pytest.mark.parametrize("clutter_set", ["seen", "unseen"])
def test_clutter_rests_at_its_initial_pose(clutter_set: str) -> None:
    varied_task = task_with("pick_meat", "clutter", clutter=(10, 10), clutter_set=clutter_set)
    with Simulator(varied_task, render=False) as world:
        for seed in range(3):
            first = world.reset(seed)
            assert {*first.clutter} == {*world.task.clutter} == {*varied_task.in_scene(seed).clutter}
            for name, pose in first.clutter.items():
                np.testing.assert_allclose(pose, world.task.clutter[name].world_from_object, atol=1e-6)
            for _ in range(20):
                scene = world.step(world.command)
            assert scene.clutter_contacts == ()
            for name, pose in scene.clutter.items():
                np.testing.assert_allclose(pose, first.clutter[name], atol=1e-3)


@pytest.mark.slow
def test_simulated_objects_have_the_sizes_of_their_scene(task: Task) -> None:
    varied_task = replace(task, variation=read_variation("instances"))
    with Simulator(varied_task, render=False) as world:
        for seed in (SEED, SEED + 1):
            first = world.reset(seed)
            for _ in range(4):
                scene = world.step(world.command)
            for name in task.objects:  # they rest on their support from the first step on
                np.testing.assert_allclose(scene.poses[name], first.poses[name], atol=2e-3)
                if not (asset := world.task.asset(name)).static and asset.hulls:
                    mass_kg = world._env.actors[name].mass[0].item()
                    # PhysX rounds the hulls.
                    assert mass_kg == pytest.approx(world._env.start.masses_kg[name], rel=0.02)


def pushing_clutter(world: Simulator, steps: int = 40):
    """Scenes of an arm that moves into clutter beside it."""
    world.step(world.command)
    for _ in range(steps):
        command = world.command
        command[0, :2] += (0.06, 0.02)
        yield world.step(command)


@pytest.mark.slow
def test_contacts_with_clutter_are_reported() -> None:
    varied_task = task_with("pick_meat", "clutter", clutter=(10, 10))
    with Simulator(varied_task, render=False) as world:
        ledger = Ledger()
        for seed in range(8):
            evaluator = SuccessEvaluator(world.task, scene := world.reset(seed))
            for scene in pushing_clutter(world):
                ledger.record(scene, evaluator(scene))
            if scene.clutter_contacts:
                break
        contacts = ledger.account(False).clutter_contacts
        assert contacts and {each.who for each in contacts} <= {"agent1"}
        assert {each.clutter for each in contacts} <= {f"clutter{k}" for k in range(1, 11)}
        assert "agent1 touched clutter" in ledger.account(False).reason


@pytest.mark.render
def test_clutter_is_visible_and_not_labelled_as_an_object() -> None:
    with Simulator(task_with("pick_meat", "clutter", clutter=(10, 10)), width_px=96, height_px=72) as world:
        world.reset(SEED)
        segmentation, bodies = world.segmentation(["global"]), world.bodies()
        pieces = [number for name in world.task.clutter for number in bodies[name]]
        is_clutter = np.isin(segmentation["global"], pieces)
        assert is_clutter.sum() > 50
        assert (label_images(world.task, segmentation, bodies)["global"][is_clutter] == 1).all()


@pytest.mark.slow
def test_episodes_with_clutter_store_only_poses_of_objects() -> None:
    varied_task = task_with("pick_meat", "clutter")
    settings = Settings.configured(varied_task, ConstraintSet("full"), ScriptedSpec())
    with Simulator(varied_task, render=False) as world:
        outcome = EpisodeGenerator(settings, world, settings.make_brain(SEED)).make(SEED)
    assert outcome.success and outcome.episode is not None, outcome.reason
    assert {*outcome.episode.poses} == {*varied_task.objects}
    drawn: Any = outcome.episode.certificate["drawn"]
    assert {*drawn["clutter"]} == {*varied_task.in_scene(SEED).clutter}
