"""Episodes with random values, stores of such episodes, and their comparison."""

from pathlib import Path

import numpy as np

from rf_exp.store import Store
from rf_exp.types import Episode

IDENTITY = {
    "task": "lift_barrier",
    "version": "1",
    "generator": "1.1",
    "seed": 100,
    "ranges": {"x_m": (-0.1, 0.1)},
}
AGENTS, CAMERAS, HEIGHT, WIDTH = 2, ("global", "agent1", "agent2"), 6, 8
OBJECTS = ("barrier",)


def make_episode(seed: int, steps: int = 7, cameras: tuple[str, ...] = CAMERAS) -> Episode:
    rng = np.random.default_rng(seed)
    return Episode(
        task="lift_barrier",
        seed=seed,
        qpos=rng.normal(size=(steps, AGENTS, 9)).astype(np.float32),
        qvel=np.zeros((steps, AGENTS, 9), np.float32),  # zeros must differ from a lost file
        action=rng.normal(size=(steps, AGENTS, 8)).astype(np.float32),
        images={c: rng.integers(0, 256, (steps, HEIGHT, WIDTH, 3), np.uint8) for c in cameras},
        certificate={"checks": ["ValidateScheduling"], "seed": seed},
        executed=rng.normal(size=(steps, AGENTS, 8)).astype(np.float32),
        poses={name: rng.normal(size=(steps, 7)).astype(np.float32) for name in OBJECTS},
        subgoal=rng.integers(0, 4, (steps, AGENTS)).astype(np.int16),
    )


def make_store(path: Path, episodes: list[Episode], cameras: tuple[str, ...] = CAMERAS) -> Path:
    with Store.create(path, IDENTITY, AGENTS, cameras, HEIGHT, WIDTH, OBJECTS, True) as store:
        for episode in episodes:
            store.append(episode)
    return path


def assert_same(actual: Episode, expected: Episode) -> None:
    assert (actual.task, actual.seed, actual.certificate) == (
        expected.task,
        expected.seed,
        expected.certificate,
    )
    for name in ("qpos", "qvel", "action", "executed", "subgoal"):
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), strict=True)
    assert set(actual.poses) == set(expected.poses)
    for name, poses in expected.poses.items():
        np.testing.assert_array_equal(actual.poses[name], poses, strict=True)
    assert set(actual.images) == set(expected.images)
    for camera, frames in expected.images.items():
        np.testing.assert_array_equal(actual.images[camera], frames, strict=True)
