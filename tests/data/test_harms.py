"""rf_exp.data doctor: every defect of a store is found, and a healthy store has no problems."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numpy.typing import NDArray

from rf_exp.data.doctor import find_problems
from rf_exp.store import Store
from rf_exp.types import Episode

AGENTS, CAMERAS, HEIGHT, WIDTH, STEPS, EPISODES = 2, ("global", "agent1", "agent2"), 6, 8, 60, 5
Command = Callable[..., Any]
Damage = Callable[[list[Episode]], list[Episode]]
pytestmark = pytest.mark.slow


def healthy_episode(seed: int) -> Episode:
    """Arms that swing, follow their commands and close their grippers, and an object that is carried."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, STEPS + 1)[:, None, None]
    path = rng.uniform(0.3, 0.8, (1, AGENTS, 7)) * np.sin(3 * time + rng.uniform(0, 3, (1, AGENTS, 7)))
    gripper = np.where(time > 0.5, -1.0, 1.0) * np.ones((1, AGENTS, 1))
    fingers = np.where(time > 0.5, 0.01, 0.04) * np.ones((1, AGENTS, 2))
    pose = np.tile(np.array([0, 0, 0, 1, 0, 0, 0], np.float32), (STEPS, 1))
    pose[:, 2] = 0.3 * time[:-1, 0, 0] + 0.01 * seed
    action = np.concatenate([path, gripper], axis=2)[1:].astype(np.float32)
    texture = np.random.default_rng(7).integers(0, 256, (len(CAMERAS), HEIGHT, WIDTH, 3))
    images = {}
    for camera, background in zip(CAMERAS, texture, strict=True):
        images[camera] = np.tile(background, (STEPS, 1, 1, 1)).astype(np.uint8)
        images[camera][np.arange(STEPS), 0, np.arange(STEPS) % WIDTH] = 200  # a moving pixel
    return Episode(
        task="lift_barrier",
        seed=seed,
        qpos=np.concatenate([path, fingers], axis=2)[:-1].astype(np.float32),
        qvel=np.zeros((STEPS, AGENTS, 9), np.float32),
        action=action,
        images=images,
        poses={"barrier": pose},
        subgoal=np.zeros((STEPS, AGENTS), np.int16),
    )


def write_store(path: Path, episodes: list[Episode]) -> Path:
    size = HEIGHT, WIDTH, ("barrier",)
    with Store.create(path, {"task": "lift_barrier"}, AGENTS, CAMERAS, *size) as store:
        for episode in episodes:
            store.append(episode)
    return path


def in_one_episode(change: Callable[[Episode], Episode]) -> Damage:
    """Applies the change to the third episode only."""
    return lambda episodes: [change(episode) if episode.seed == 2 else episode for episode in episodes]


def in_all_episodes(change: Callable[[Episode], Episode]) -> Damage:
    return lambda episodes: [change(episode) for episode in episodes]


def set_at(name: str, index: Any, value: float) -> Callable[[Episode], Episode]:
    def change(episode: Episode) -> Episode:
        values: NDArray[Any] = getattr(episode, name).copy()
        values[index] = value
        return replace(episode, **{name: values})

    return change


def in_pictures(change: Callable[[dict[str, NDArray[np.uint8]]], dict[str, NDArray[np.uint8]]]) -> Damage:
    return in_all_episodes(
        lambda episode: replace(episode, images={**episode.images, **change(dict(episode.images))})
    )


def throw_object(episode: Episode) -> Episode:
    pose = episode.poses["barrier"].copy()
    pose[30:, 0] += 2.0
    return replace(episode, poses={"barrier": pose})


def add_jerk(episode: Episode) -> Episode:
    noise = np.random.default_rng(1).normal(scale=0.03, size=episode.qpos.shape)
    return replace(episode, qpos=(episode.qpos + noise).astype(np.float32))


def truncate(episode: Episode) -> Episode:
    states = {name: getattr(episode, name)[:6] for name in ("qpos", "qvel", "action", "subgoal")}
    images = {name: pictures[:6] for name, pictures in episode.images.items()}
    return replace(episode, **states, images=images, poses={n: p[:6] for n, p in episode.poses.items()})


def freeze_camera(episode: Episode) -> Episode:
    pictures = episode.images["global"]
    return replace(
        episode, images={**episode.images, "global": np.repeat(pictures[:1], len(pictures), axis=0)}
    )


def stop_arms(episode: Episode) -> Episode:
    constant = {name: np.repeat(getattr(episode, name)[:1], STEPS, axis=0) for name in ("qpos", "action")}
    return replace(episode, **constant)


DEFECTS: dict[str, tuple[Damage, str]] = {
    "a dead joint": (
        in_all_episodes(set_at("qpos", (..., 1, 3), 0.5)),
        "agent 2, panda_joint4: qpos never moves in 300 steps",
    ),
    "a dead command": (
        in_all_episodes(set_at("action", (..., 0, 0), 0.0)),
        "agent 1, panda_joint1: action never moves in 300 steps",
    ),
    "stuck fingers": (
        in_all_episodes(set_at("qpos", (..., 0, slice(7, 9)), 0.04)),
        "agent 1: its gripper is commanded to move, but its fingers never do",
    ),
    "a jump": (
        in_one_episode(set_at("qpos", (20, 0, 2), 2.5)),
        "episode 2 (seed 2), step 20: qpos of agent 1, panda_joint3 jumps by ",
    ),
    "a thing that is thrown": (
        in_one_episode(throw_object),
        "episode 2 (seed 2), step 30: pose_barrier jumps by 2.00 m",
    ),
    "a rough arm": (in_one_episode(add_jerk), "episode 2 (seed 2): its arms jerk "),
    "a still episode": (in_one_episode(stop_arms), "episode 2 (seed 2): no arm moves in its 60 steps"),
    "an episode that was cut": (
        in_one_episode(truncate),
        "episode 2 (seed 2): it has 6 steps, where 60 are usual",
    ),
    "an episode twice": (
        lambda episodes: [*episodes, replace(episodes[1], seed=99)],
        "episode 5 (seed 99): it is a duplicate of episode 1",
    ),
    "commands of the other arm": (
        in_all_episodes(lambda episode: replace(episode, action=1.0 + 2 * episode.action[:, ::-1])),
        "agent 1: half of the time 7 of its joints are far from their commands",
    ),
    "a thing that never moves": (
        in_all_episodes(
            lambda episode: replace(episode, poses={"barrier": 0 * episode.poses["barrier"] + 1})
        ),
        "barrier: no object ever moves",
    ),
    "a dark camera": (
        in_pictures(lambda images: {"global": images["global"] // 40}),
        "camera global: its pictures are black: level 3",
    ),
    "a camera of one colour": (
        in_pictures(lambda images: {"agent1": 0 * images["agent1"] + 90}),
        "camera agent1: its pictures have one colour",
    ),
    "a frozen camera": (
        in_one_episode(freeze_camera),
        "camera global: its pictures never change in 1 of 5 episodes that were examined, the first of them 2",
    ),
    "cameras that are one": (
        in_pictures(lambda images: {"agent2": images["agent1"]}),
        "cameras agent1 and agent2: they show the same",
    ),
}


def test_a_healthy_store_has_no_problems(tmp_path: Path, data_command: Command) -> None:
    path = write_store(tmp_path / "s.zarr", [healthy_episode(seed) for seed in range(EPISODES)])
    code, output, errors = data_command("doctor", path, "--reference", path)
    assert (code, errors) == (0, "")
    assert "no problems for training were found" in output.replace("\n", " ")


@pytest.mark.parametrize("defect", DEFECTS)
def test_every_defect_is_found_at_its_place(defect: str, tmp_path: Path) -> None:
    damage, message = DEFECTS[defect]
    path = write_store(tmp_path / "s.zarr", damage([healthy_episode(seed) for seed in range(EPISODES)]))
    problems = [str(problem) for problem in find_problems(Store.open(path))]
    assert any(message in problem for problem in problems), problems
    assert len(problems) <= 2, problems


def test_values_that_are_not_finite_are_found(tmp_path: Path) -> None:
    """A store refuses such values; other writers may not."""
    path = write_store(tmp_path / "s.zarr", [healthy_episode(seed) for seed in range(EPISODES)])
    array: Any = zarr.open_group(path, mode="r+")["data/qvel"]
    array[2 * STEPS + 7, 1, 3] = np.nan
    (problem,) = map(str, find_problems(Store.open(path)))
    assert problem.startswith(
        "episode 2 (seed 2), step 7: qvel is not finite in 1 steps, this the first; no policy"
    )


def test_pictures_darker_than_the_reference_are_found(tmp_path: Path, data_command: Command) -> None:
    episodes = [healthy_episode(seed) for seed in range(EPISODES)]
    reference = write_store(tmp_path / "reference.zarr", episodes)
    darker = in_pictures(lambda images: {"agent1": (images["agent1"] * 0.9).astype(np.uint8)})
    path = write_store(tmp_path / "dark.zarr", darker(episodes))
    code, output, errors = data_command("doctor", path, "--reference", reference)
    assert code == 1 and "1 of 1 stores have problems that will harm training" in errors
    assert "camera agent1: its pictures are 10% darker than those of reference.zarr" in output.replace(
        "\n", " "
    )
    assert data_command("doctor", path)[0] == 0


def test_a_reference_without_a_common_camera_is_refused(tmp_path: Path, data_command: Command) -> None:
    path = write_store(tmp_path / "s.zarr", [healthy_episode(0)])
    with Store.create(
        tmp_path / "none.zarr", {"task": "lift_barrier"}, AGENTS, (), 0, 0, ("barrier",)
    ) as store:
        store.append(replace(healthy_episode(1), images={}))
    code, _, errors = data_command("doctor", path, "--reference", tmp_path / "none.zarr")
    assert code == 2 and "none.zarr has cameras none, s.zarr global, agent1, agent2" in errors.replace(
        "\n", " "
    )
