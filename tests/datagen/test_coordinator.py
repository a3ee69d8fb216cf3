"""The coordinator: its subgoals and permissions agree with the labels of demonstrations."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.datagen import Coordinator, EpisodeGenerator, NullObserver, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.policy.inputs.coordination import may_go_on_mask
from rf_exp.sim import Simulator
from rf_exp.types import ConstraintSet, Scene
from tests.conftest import TASKS, read_task

SEQUENTIAL = ("long_pipeline_delivery", "pass_shoe", "three_robots_stack_cube")  # also tested without delays


class SceneRecorder(NullObserver):
    """Observer that records the scene before each step."""

    def __init__(self) -> None:
        self.scenes: list[Scene] = []

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        self.scenes.append(scene)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "delay_s", "alike"),
    [(name, 1.0, 0.85) for name in TASKS] + [(name, 0.0, 0.87) for name in SEQUENTIAL],
)
def test_the_coordinator_agrees_with_demonstrations(name: str, delay_s: float, alike: float) -> None:
    """In disturbed episodes, at nearly all steps; and at the end some agent may go on.

    Where arms pause, others wait for them in places where the coordinator's plan has no wait.
    """
    task = read_task(name)
    settings = Settings.configured(
        task, ConstraintSet("full"), ScriptedSpec(), disturbance_rad=0.05, delay_s=delay_s
    )
    with Simulator(task, render=False) as world:
        for seed in range(3):
            recorder = SceneRecorder()
            episode = (
                EpisodeGenerator(settings, world, settings.make_brain(seed), recorder).make(seed).episode
            )
            if episode is not None:
                break
    assert episode is not None and episode.subgoal is not None and episode.executed is not None
    coordinator = Coordinator(replace(settings, disturbance_rad=0.0), episode.seed, recorder.scenes[0])
    numbers, free = [], []
    grippers_of = episode.executed[..., -1]
    commands = np.concatenate([np.ones_like(grippers_of[:1]), grippers_of[:-1]])
    for scene, grippers in zip(recorder.scenes, commands, strict=True):
        subgoals, may_go_on = coordinator(scene, dict(enumerate(grippers, start=1)))
        numbers.append(subgoals)
        free.append(may_go_on)
    assert np.mean(np.array(numbers) == episode.subgoal) > 0.9
    assert np.mean(np.array(free) == may_go_on_mask(episode.qpos, episode.action, episode.executed)) > alike
    assert np.array(free)[-1].any()  # no deadlock
