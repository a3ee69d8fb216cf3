"""What the depth cameras see, over all tasks and whole episodes: what is there, and nothing else."""

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

EVERY_STEPS = 15  # of an episode are looked at
SURFACE_M = 0.005  # between what is drawn and the shape that checks know
VISIBLE_PX = 200  # an object of which a camera sees so much must be found


class Looking(NullObserver):
    """Compares at many moments of an episode what the cameras see with the measured state."""

    def __init__(self, world: Simulator) -> None:
        self.world, self.looks, self.with_load = world, 0, 0

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        if scene.step % EVERY_STEPS:
            return
        world, planning_scene = self.world, PlanningScene(self.world.task, scene)
        free = [name for name in world.task.objects if name not in scene.held]
        filled = {name: voxels(planning_scene.static_objects([name])) for name in free}
        seen = occupied_voxels(world.depth(), world.camera_models(), planning_scene)
        stray = seen[~within_margin(seen, planning_scene.static_objects(free), SURFACE_M)]
        assert len(stray) == 0, (scene.step, stray)
        numbers, images = world.bodies(), world.segmentation()
        for name in free:
            visible_px = max(int(np.isin(image, numbers[name]).sum()) for image in images.values())
            if visible_px > VISIBLE_PX and len(filled[name]):  # a mark on the table fills nothing
                assert len(shared(seen, filled[name])), (scene.step, name, visible_px)
        self.looks += 1
        self.with_load += any(scene.held)


def make(
    task: Task, world: Simulator, occupancy: Occupancy, observer: NullObserver, seed: int = 0
) -> Outcome:
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec(), occupancy=occupancy)
    return EpisodeGenerator(settings, CameraSubset(world), ScriptedBrain(), observer).make(seed)


@pytest.mark.render
@pytest.mark.slow
def test_all_that_is_seen_is_there_and_arms_with_their_loads_are_not_seen(task: Task) -> None:
    with Simulator(task) as world:
        looking = Looking(world)
        outcome = make(task, world, "depth", looking)
    assert outcome.success, outcome.reason
    assert looking.looks > 3 and looking.with_load > 0


@pytest.mark.render
@pytest.mark.slow
def test_a_box_that_no_task_knows_is_avoided_by_what_the_cameras_see() -> None:
    task = read_task("pass_shoe")
    box = ObjectSpec("plinth", x_m=(-0.2, -0.2), y_m=(-0.22, -0.22), options={"half_m": 0.1})
    with Simulator(replace(task, objects={**task.objects, "box": box})) as world:
        blind = make(task, world, "state", NullObserver())
        pushed = [each for each in blind.account.rejections if each.finding is Finding.PUSHES]
        assert pushed and "arms stop at 20 N" in pushed[0].sentence
        assert pushed[0].obstacles == ("box",)  # whether it gets past it in the end, or not
        outcome = make(task, world, "depth", NullObserver())
        assert outcome.success and outcome.attempts == 1, outcome.reason  # it meets nothing
        again = make(task, world, "depth", NullObserver())
    assert outcome.episode is not None and again.episode is not None
    np.testing.assert_array_equal(outcome.episode.action, again.episode.action)


def test_a_simulator_without_cameras_says_so(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as world, pytest.raises(ArgumentError, match="render=True"):
        make(lift_barrier, world, "depth", NullObserver())
