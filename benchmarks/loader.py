"""Cost of a batch: our windows against a plain loader, in one run.

    python benchmarks/loader.py [--size paper|compact] [--batches 5]

Both read the same pictures from memory. The plain loader works like Diffusion Policy's: for each sample
it copies the pictures of the whole horizon, converts them to floats, normalises and stacks; the policy then
uses the first three. Ours returns uint8 crops of the frames needed, each once, and the policy converts
them to floats, which is timed too. The last line is JSON: medians in ms, and the ratio.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.command import CONF
from rf_exp.experiment import Experiment, read_experiment
from rf_exp.policy import PolicyConfig, Stream, View, Windows

EPISODES, STEPS, BATCH, RUN = 4, 60, 128, 8
VIEW = View("agent1", (Stream("agent1", (1,)),))

COMPACT = (
    *(
        "policy.encoder.name=compact",
        "policy.head.diffusion.channels=[32,64]",
        "policy.relative_actions=true",
    ),
    *("policy.head.diffusion.sampler=ddim", "policy.head.diffusion.inference_steps=10"),
    *("policy.head.diffusion.prediction=sample", "picture={width: 128, height: 96}"),
)


def recipe(size: str, *changes: str) -> Experiment:
    """The paper's recipe, or a small one for `compact`, with overrides."""
    small = COMPACT if size == "compact" else ()
    with initialize_config_dir(str(CONF), version_base=None):
        config = compose("config", ["recipe=paper", "policy=paper", *small, *changes])
    return read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Noise:
    """Stand-in for a store with the attributes that `Windows` reads, filled with noise."""

    qpos: NDArray[np.float32]
    action: NDArray[np.float32]
    images: dict[str, NDArray[np.uint8]]
    episode_ends: NDArray[np.int64]
    cameras: tuple[str, ...] = ("agent1",)
    models: tuple[Any, ...] = ()
    objects: tuple[str, ...] = ()
    agents: int = 1

    def __len__(self) -> int:
        return len(self.episode_ends)

    def by_episode(self, values: NDArray) -> list[NDArray]:
        return np.split(values, self.episode_ends[:-1])

    @property
    def executed(self) -> NDArray[np.float32]:
        return self.action

    @property
    def subgoal(self) -> NDArray[np.int16]:
        return np.zeros((self.steps, self.agents), np.int16)

    @property
    def steps(self) -> int:
        return len(self.qpos)


def noise(config: PolicyConfig) -> Noise:
    rng = np.random.default_rng(0)
    rows = EPISODES * STEPS
    return Noise(
        rng.normal(size=(rows, 1, 9)).astype(np.float32),
        rng.normal(size=(rows, 1, 8)).astype(np.float32),
        {"agent1": rng.integers(0, 256, (rows, config.height, config.width, 3), dtype=np.uint8)},
        np.arange(1, EPISODES + 1) * STEPS,
    )


def plain(store: Noise, config: PolicyConfig, windows: NDArray[np.int64]) -> torch.Tensor:
    """Pictures (B, horizon, 3, H, W) as floats, collected sample by sample."""
    samples = []
    for window in windows:
        rows = np.clip(np.arange(window - 2, window - 2 + config.horizon), 0, len(store.qpos) - 1)
        pictures = np.moveaxis(store.images["agent1"][rows], -1, 1).astype(np.float32) / 255
        samples.append({"pictures": torch.from_numpy(pictures), "action": store.action[rows]})
    return torch.stack([sample["pictures"] for sample in samples]) * 2 - 1


def ours(windows: Windows, indices: NDArray[np.int64], rng: np.random.Generator) -> torch.Tensor:
    """Pictures (U, 3, h, w) as floats of the unique frames of a batch."""
    return windows.batch(indices, rng).pictures.permute(0, 3, 1, 2).float().div(127.5).sub(1.0)


def milliseconds(action: Callable[[], object]) -> float:
    begin = time.perf_counter()
    action()
    return (time.perf_counter() - begin) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--size", choices=("paper", "compact"), default="paper")
    parser.add_argument("--batches", type=int, default=5)
    args = parser.parse_args()
    config = recipe(args.size).policy
    store = noise(config)
    windows = Windows(store, VIEW, config, torch.device("cpu"))  # pyright: ignore[reportArgumentType]
    rng = np.random.default_rng(0)
    batches = windows.epoch(BATCH, RUN, rng)
    times: dict[str, list[float]] = {"plain": [], "ours": []}
    for index in range(args.batches + 1):  # the first round warms up
        indices = batches[index % len(batches)]
        times["plain"].append(milliseconds(lambda indices=indices: plain(store, config, indices)))
        times["ours"].append(milliseconds(lambda indices=indices: ours(windows, indices, rng)))
    result = {name: round(median(values[1:]), 2) for name, values in times.items()}
    print(f"{len(batches[0])} windows a batch, {config.width}x{config.height}, {args.batches} batches each")
    ratio = round(result["plain"] / result["ours"], 2)
    print(json.dumps({"size": args.size, **{f"{k}_ms": v for k, v in result.items()}, "ratio": ratio}))


if __name__ == "__main__":
    main()
