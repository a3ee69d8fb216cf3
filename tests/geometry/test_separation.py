"""Overlaps of arms in consecutive scenes equal those of each scene alone."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from rf_exp.geometry import PlanningScene, Separation, measured_pair, overlap, separation
from rf_exp.tasks import named_task
from rf_exp.transforms import Matrix, transform
from rf_exp.types import Scene
from tests.scenes import start_scene

STEPS = 150
STEP_RAD, LEAN_RAD = 0.008, 0.045  # per joint and control step: random, and towards the other arms
NOTHING = frozenset[str]()


def random_motion(name: str, rng: np.random.Generator) -> list[Scene]:
    """Arms in random motion; from time to time one grasps or releases an object."""
    task = named_task(name)
    assert task is not None
    scene = start_scene(task, 0)
    inwards = np.array([0.0, 0.9, 0.0, 0.7, 0.0, 0.2, 0.0])  # towards the other arms
    scenes, speed = [scene], rng.normal(0.0, STEP_RAD, (len(task.robots), 7))
    for step in range(1, STEPS):
        speed = 0.9 * speed + rng.normal(0.0, STEP_RAD / 3, speed.shape)
        qpos = scene.qpos.copy()
        qpos[:, :7] += speed + inwards * LEAN_RAD * np.cos(step / 20)
        poses, held = dict(scene.poses), list(scene.held)
        if step % 20 == 0:
            agent = int(rng.integers(len(held)))
            held[agent] = None if held[agent] else str(rng.choice(list(task.objects)))
        for agent, thing in enumerate(held, start=1):
            if thing is not None:
                tcp: Matrix = task.arms[agent].tcp(qpos[agent - 1])
                poses[thing] = tcp @ transform((0.0, 0.0, 0.02))
        scene = replace(scene, step=step, qpos=qpos, poses=poses, held=tuple(held))
        scenes.append(scene)
    return scenes


@pytest.mark.slow
@pytest.mark.parametrize(("name", "free"), [("take_photo", False), ("tower_5x1", True)])
def test_results_equal_those_of_each_scene_alone(name: str, free: bool) -> None:
    """Also with objects that grippers may touch, and with an object held by two arms."""
    task = named_task(name)
    assert task is not None
    things = frozenset(task.objects) if free else NOTHING
    counts = {True: 0, False: 0}
    for seed in range(2):
        tracked = Separation(task)
        for scene in random_motion(name, np.random.default_rng(seed)):
            for pair in combinations(task.agents, 2):
                expected = overlap(*measured_pair(PlanningScene(task, scene), pair, lambda agent: things))
                assert tracked.overlap(scene, pair, lambda agent: things) == expected, (
                    seed,
                    scene.step,
                    pair,
                )
                counts[expected is not None] += 1
    assert min(counts.values()) > 20, "the arms never meet, or always do: it proves nothing"


def test_arms_that_move_little_are_evaluated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    task = named_task("tower_4x1")
    assert task is not None
    evaluations, bounds = [], separation._bounds_m
    monkeypatch.setattr(separation, "_bounds_m", lambda *bodies: evaluations.append(1) or bounds(*bodies))
    tracked, scene = Separation(task), start_scene(task, 0)
    for step in range(50):
        qpos = scene.qpos.copy()
        qpos[:, :7] += 1e-3
        scene = replace(scene, step=step, qpos=qpos)
        for pair in combinations(task.agents, 2):
            assert tracked.overlap(scene, pair, lambda agent: NOTHING) is None
    assert len(evaluations) == 6
