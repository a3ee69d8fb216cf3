"""Who is told what while policies act: what the demonstrations say of the same moments."""

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

IN_TURN = ("long_pipeline_delivery", "pass_shoe", "three_robots_stack_cube")  # without delays as well


class Scenes(NullObserver):
    """Keeps the scenes before each step."""

    def __init__(self) -> None:
        self.scenes: list[Scene] = []

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        self.scenes.append(scene)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "delay_s", "alike"),
    [(name, 1.0, 0.85) for name in TASKS] + [(name, 0.0, 0.87) for name in IN_TURN],
)
def test_it_says_what_demonstrations_say(name: str, delay_s: float, alike: float) -> None:
    """Of disturbed episodes, at nearly all moments; and nobody is told to wait for ever.

    Where arms pause, others wait for them at places where the coordinator's plan has no wait.
    """
    task = read_task(name)
    settings = Settings.configured(
        task, ConstraintSet("full"), ScriptedSpec(), disturbance_rad=0.05, delay_s=delay_s
    )
    with Simulator(task, render=False) as world:
        for seed in range(3):
            watching = Scenes()
            made = EpisodeGenerator(settings, world, settings.make_brain(seed), watching).make(seed).episode
            if made is not None:
                break
    assert made is not None and made.subgoal is not None and made.executed is not None
    coordinator = Coordinator(replace(settings, disturbance_rad=0.0), made.seed, watching.scenes[0])
    numbers, free = [], []
    grippers_of = made.executed[..., -1]
    commands = np.concatenate([np.ones_like(grippers_of[:1]), grippers_of[:-1]])
    for scene, grippers in zip(watching.scenes, commands, strict=True):
        at, go = coordinator(scene, dict(enumerate(grippers, start=1)))
        numbers.append(at)
        free.append(go)
    assert np.mean(np.array(numbers) == made.subgoal) > 0.9
    assert np.mean(np.array(free) == may_go_on_mask(made.qpos, made.action, made.executed)) > alike
    assert np.array(free)[-1].any()  # somebody may always go on
