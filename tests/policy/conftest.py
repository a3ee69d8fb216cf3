"""A small learnable world: the place of a block in the picture determines the goal of its arm."""

import csv
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.artifacts import plain, read_values
from rf_exp.observations import Observation, observe
from rf_exp.policy import CURVES, PolicyConfig, PolicyRunner, TrainConfig
from rf_exp.policy.bounds import merged
from rf_exp.store import Store
from rf_exp.transforms import from_quaternion
from rf_exp.types import Arch, Episode, Scene
from tests.conftest import CONF

HEIGHT, WIDTH, STEPS = 32, 48, 24
STILL = 5  # steps before the arms move: until then only the picture shows the goal
ARCHS = tuple(
    Arch(f"{policy}_{view}", policy == "shared", view == "global")
    for policy in ("shared", "separate")
    for view in ("global", "local")
)
REST = np.array([0.0, 0.4, 0.0, -1.9, 0.0, 2.3, 0.8])


def block_position(seed: int, agents: int) -> NDArray[np.float64]:
    """(N, 2) positions of the blocks, one per agent, in [-1, 1]."""
    return np.random.default_rng([seed, 7]).uniform(-1, 1, (agents, 2))


def block_poses(seed: int, agents: int) -> dict[str, NDArray[np.float32]]:
    """Block -> (7,) position and quaternion."""
    return {
        f"block{k}": np.array([*block, 0.02, 1, 0, 0, 0], np.float32)
        for k, block in enumerate(block_position(seed, agents), start=1)
    }


def scene_of(agents: int) -> dict[str, object]:
    """The scene in a store's identity: bases of the arms and cameras."""
    robots = [{"x_m": 0.5 * k, "y_m": -0.3, "yaw_deg": 90.0 * k} for k in range(agents)]
    camera = {"eye_m": [1.8, 0.2, 1.2], "target_m": [0.4, 0.1, 0.3], "fov_deg": 70.0, "mount": "world"}
    names = ("global", *(f"agent{k}" for k in range(1, agents + 1)))
    return {"robots": robots, "cameras": {name: dict(camera) for name in names}}


def goal(block: NDArray[np.float64]) -> NDArray[np.float64]:
    """(7,) rad: the joints that an arm must reach for a block at (2,)."""
    change = np.zeros(7)
    change[[0, 1, 3]] = 0.4 * block[0], 0.3 * block[1], -0.3 * block[1]
    return REST + change


def picture(block: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A red block on grey: x to the right, y down."""
    image = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    row, column = round(HEIGHT / 2 + 9 * block[1]), round(WIDTH / 2 + 15 * block[0])
    image[row - 3 : row + 4, column - 3 : column + 4] = (220, 40, 40)
    return image


def make_episode(seed: int, agents: int) -> Episode:
    blocks = block_position(seed, agents)
    part = np.clip((np.arange(STEPS + 1) - STILL) / (STEPS - STILL - 6), 0, 1)
    path = np.stack(
        [REST + part[:, None] * (goal(block) - REST) for block in blocks], axis=1
    )  # (T + 1, N, 7)
    gripper = np.where(part >= 1, -1.0, 1.0)
    fingers = np.where(part >= 1, 0.01, 0.04)[:-1, None, None] * np.ones((1, agents, 2))
    action = np.concatenate([path[1:], np.repeat(gripper[1:, None, None], agents, axis=1)], axis=2)
    frames = {f"agent{k}": picture(block) for k, block in enumerate(blocks, start=1)}
    frames["global"] = frames["agent1"]
    qpos = np.concatenate([path[:-1], fingers], axis=2).astype(np.float32)
    pictures = {camera: np.repeat(frame[None], STEPS, axis=0) for camera, frame in frames.items()}
    poses = {name: np.tile(pose, (STEPS, 1)) for name, pose in block_poses(seed, agents).items()}
    doing = np.repeat((gripper[1:, None] < 0).astype(np.int16), agents, axis=1)
    moved = qpos, np.zeros_like(qpos), action.astype(np.float32)
    return Episode("reach", seed, *moved, pictures, poses=poses, subgoal=doing)


def scene_at(episode: Episode, step: int) -> Scene:
    """The scene at a step of an episode, with zero velocities."""
    poses = {name: from_quaternion(values[step]) for name, values in episode.poses.items()}
    qpos = episode.qpos[step].astype(float)
    return Scene(step, qpos, np.zeros_like(qpos), poses, {}, (None,) * len(qpos))


def shown(runner: PolicyRunner, scene: Scene, pictures: Mapping[str, NDArray[np.uint8]]) -> Observation:
    """The observation that a runner receives of a scene and its pictures."""
    (found,) = observe(scene, StillWorld(pictures), [runner.declaration])
    return found


class StillWorld:
    """World that only has pictures: it is never reset or moved."""

    def __init__(self, pictures: Mapping[str, NDArray[np.uint8]]) -> None:
        self.pictures = pictures
        self.cameras = tuple(pictures)

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        return {name: self.pictures[name] for name in (self.cameras if cameras is None else cameras)}

    def reset(self, seed: int) -> Scene:
        raise NotImplementedError

    def step(self, action: NDArray[np.float64]) -> Scene:
        raise NotImplementedError


def write_store(path: Path, agents: int, episodes: int) -> Path:
    """A store of the episodes of the first seeds."""
    cameras = ("global", *(f"agent{k}" for k in range(1, agents + 1)))
    identity = {"task": "reach", "scene": scene_of(agents)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with Store.create(path, identity, agents, cameras, HEIGHT, WIDTH, tuple(block_poses(0, agents))) as store:
        for seed in range(episodes):
            store.append(make_episode(seed, agents))
    return path


@pytest.fixture(scope="session")
def make_store(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int, int], Store]:
    """(agents, episodes) -> a store of that many episodes; made once a session."""
    made: dict[tuple[int, int], Store] = {}

    def make(agents: int, episodes: int) -> Store:
        if (agents, episodes) not in made:
            path = tmp_path_factory.mktemp("store") / "reach.zarr"
            made[agents, episodes] = Store.open(write_store(path, agents, episodes))
        return made[agents, episodes]

    return make


def varied(config: PolicyConfig, changes: Mapping[str, Any]) -> PolicyConfig:
    """The config with changes, dotted key -> value. Sections that it lacks are as in the paper's recipe."""
    node = merged(_paper()["policy"], plain(config.identity))
    return PolicyConfig.read(merged(node, _nested(changes)))


def small_policy(**changes: Any) -> PolicyConfig:
    """Config with the paper's windows and networks that learn in seconds; `changes` by dotted keys."""
    diffusion = {"channels": (16, 32), "sampler": "ddim", "inference_steps": 10, "prediction": "sample"}
    small = {
        "encoder.name": "compact",
        **{f"head.diffusion.{key}": value for key, value in diffusion.items()},
        "relative_actions": True,
        "height": 96,
        "width": 128,
    }
    return PolicyConfig.read(merged(_paper()["policy"], _nested(small | changes)))


def paper_policy(height: int = 240, width: int = 320) -> PolicyConfig:
    """The paper's recipe."""
    return PolicyConfig.read({**_paper()["policy"], "height": height, "width": width})


def training_of(**changes: Any) -> TrainConfig:
    """The paper's training with other values."""
    return read_values(TrainConfig, _paper()["training"] | changes)


@cache
def _paper() -> dict[str, Any]:
    """`conf/policy/paper.yaml`, which holds the defaults."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "policy" / "paper.yaml"))
    del node["policy"]["code"]
    return node


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys -> mappings of mappings."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        for part in reversed(key.split(".")):
            value = {part: value}
        found = merged(found, value)
    return found


def rows(folder: Path) -> list[dict[str, str]]:
    """The curves of a training."""
    with (folder / CURVES).open(newline="") as file:
        return list(csv.DictReader(file))


def small_training(steps: int, **changes: Any) -> TrainConfig:
    """Training with small batches and a larger learning rate than the paper's."""
    values = {"batch_size": 32, "run_length": 4, "learning_rate": 1e-3, "warmup_steps": 50}
    return training_of(**({"epochs": None, "steps": steps} | values | changes))


@pytest.fixture
def policy_config() -> PolicyConfig:
    return small_policy(**{"height": HEIGHT, "width": WIDTH, "head.diffusion.noise_draws": 2})


@pytest.fixture
def train_config() -> TrainConfig:
    """A few steps only; `checkpoint_every` beyond the end, so that only Ctrl-C writes a state."""
    return small_training(6, batch_size=16, warmup_steps=2, log_every=4, device="cpu")
