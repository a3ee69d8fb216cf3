"""Occupancy from depth cameras, over all tasks and whole episodes: it shows all objects and nothing else."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.datagen import EpisodeGenerator, NullObserver, Outcome, Settings
from rf_exp.datagen.brain import ScriptedBrain, ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.findings import Finding
from rf_exp.geometry import PlanningScene, shared, voxels, within_margin
from rf_exp.perception import occupied_voxels
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import ObjectSpec, Task
from rf_exp.types import ConstraintSet, Occupancy, Scene
from tests.conftest import read_task

EVERY_STEPS = 15  # of an episode, between two comparisons
SURFACE_M = 0.005  # between rendered surface and collision shape
VISIBLE_PX = 200  # an object with more pixels in a picture must be found


class OccupancyComparison(NullObserver):
    """Compares the occupancy from depth with the measured state, at many moments of an episode."""

    def __init__(self, world: Simulator) -> None:
        self.world, self.comparisons, self.with_load = world, 0, 0

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        if scene.step % EVERY_STEPS:
            return
        world, planning_scene = self.world, PlanningScene(self.world.task, scene)
        free = [name for name in world.task.objects if name not in scene.held]
        voxels_of = {name: voxels(planning_scene.static_objects([name])) for name in free}
        occupied = occupied_voxels(world.depth(), world.camera_models(), planning_scene)
        stray = occupied[~within_margin(occupied, planning_scene.static_objects(free), SURFACE_M)]
        assert len(stray) == 0, (scene.step, stray)
        body_numbers, images = world.bodies(), world.segmentation()
        for name in free:
            visible_px = max(int(np.isin(image, body_numbers[name]).sum()) for image in images.values())
            if visible_px > VISIBLE_PX and len(voxels_of[name]):  # a mark on the table has no volume
                assert len(shared(occupied, voxels_of[name])), (scene.step, name, visible_px)
        self.comparisons += 1
        self.with_load += any(scene.held)


def run_episode(
    task: Task, world: Simulator, occupancy: Occupancy, observer: NullObserver, seed: int = 0
) -> Outcome:
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec(), occupancy=occupancy)
    return EpisodeGenerator(settings, CameraSubset(world), ScriptedBrain(), observer).make(seed)


@pytest.mark.render
@pytest.mark.slow
def test_occupancy_from_depth_matches_the_scene_without_arms_and_held_objects(task: Task) -> None:
    with Simulator(task) as world:
        observer = OccupancyComparison(world)
        outcome = run_episode(task, world, "depth", observer)
    assert outcome.success, outcome.reason
    assert observer.comparisons > 3 and observer.with_load > 0


@pytest.mark.render
@pytest.mark.slow
def test_an_unknown_box_is_avoided_with_depth_cameras() -> None:
    task = read_task("pass_shoe")
    box = ObjectSpec("plinth", x_m=(-0.2, -0.2), y_m=(-0.22, -0.22), options={"half_m": 0.1})
    with Simulator(replace(task, objects={**task.objects, "box": box})) as world:
        without_depth = run_episode(task, world, "state", NullObserver())
        pushes = [each for each in without_depth.account.rejections if each.finding is Finding.PUSHES]
        assert pushes and "arms stop at 20 N" in pushes[0].sentence
        assert pushes[0].obstacles == ("box",)  # whether or not the episode succeeds in the end
        outcome = run_episode(task, world, "depth", NullObserver())
        assert outcome.success and outcome.attempts == 1, outcome.reason  # it touches nothing
        again = run_episode(task, world, "depth", NullObserver())
    assert outcome.episode is not None and again.episode is not None
    np.testing.assert_array_equal(outcome.episode.action, again.episode.action)


def test_depth_without_cameras_is_refused(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as world, pytest.raises(ArgumentError, match="render=True"):
        run_episode(lift_barrier, world, "depth", NullObserver())
