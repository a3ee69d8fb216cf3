"""Reads an export with lerobot: compares values with the store, trains on one batch.

    PYTHON benchmarks/lerobot_reads.py EXPORT STORE

PYTHON belongs to a separate environment with lerobot and zarr: lerobot needs another torch than we do. The
last line is JSON.
"""

# pyright: reportMissingImports=false
import argparse
import json
import time
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr


def named(name: str, *modules: str) -> Any:
    """A name of lerobot that has moved between modules. Raises ImportError where none has it."""
    for module in modules:
        try:
            return getattr(import_module(module), name)
        except (ImportError, AttributeError):
            continue
    raise ImportError(f"lerobot {metadata.version('lerobot')} has no {name} in {', '.join(modules)}")


def compare(data: Any, store: zarr.Group, row_count: int) -> dict[str, bool]:
    """Whether states, actions and pictures equal those of the store, in rows spread over all of it."""
    arrays: Any = store["data"]
    rows = np.unique(np.linspace(0, len(data) - 1, row_count).astype(int)).tolist()
    items = [data[row] for row in rows]
    pairs = {"observation.state": "qpos", "action": "action"}
    same = {
        name: all(
            np.array_equal(item[name].numpy(), np.asarray(arrays[array][row]).ravel())
            for row, item in zip(rows, items, strict=True)
        )
        for name, array in pairs.items()
    }
    for camera in store.attrs["cameras"]:  # pyright: ignore
        key = f"observation.images.{camera}"
        same[key] = all(
            np.array_equal(
                np.rint(item[key].numpy() * 255).astype(np.uint8),
                np.moveaxis(np.asarray(arrays[f"rgb_{camera}"][row]), -1, 0),
            )
            for row, item in zip(rows, items, strict=True)
        )
    return same


def train(folder: Path, data: Any, batch_size: int) -> float:
    """Trains ACT for one step on one batch; returns the loss."""
    from lerobot.configs.types import FeatureType
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    dataset = type(data)
    to_policy_features = named(
        "dataset_to_policy_features", "lerobot.datasets.utils", "lerobot.utils.feature_utils"
    )
    features = to_policy_features(data.meta.features)
    outputs = {name: feature for name, feature in features.items() if feature.type is FeatureType.ACTION}
    inputs = {name: feature for name, feature in features.items() if name not in outputs}
    assert list(outputs) == ["action"] and "observation.state" in inputs
    config = ACTConfig(
        input_features=inputs,
        output_features=outputs,
        chunk_size=10,
        n_action_steps=10,
        dim_model=64,
        dim_feedforward=128,
        n_heads=4,
        pretrained_backbone_weights=None,  # pyright: ignore[reportArgumentType]
        device="cpu",
    )
    rate = data.meta.fps
    windows = dataset("rf_exp", root=folder, delta_timestamps={"action": [k / rate for k in range(10)]})
    policy = ACTPolicy(config).train()
    before, _ = make_pre_post_processors(config, dataset_stats=data.meta.stats)
    batch = next(iter(torch.utils.data.DataLoader(windows, batch_size, shuffle=True)))
    optimizer = torch.optim.AdamW(policy.parameters(), 1e-4)
    loss, _ = policy.forward(before(batch))
    loss.backward()
    optimizer.step()
    return float(loss.detach())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("export", type=Path)
    parser.add_argument("store", type=Path)
    parser.add_argument("--rows", type=int, default=60, help="to compare")
    args = parser.parse_args()
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    began = time.perf_counter()
    data = LeRobotDataset("rf_exp", root=args.export)
    same = compare(data, zarr.open_group(args.store, mode="r"), args.rows)
    loss = train(args.export, data, 8)
    print(data)
    result = {
        "lerobot": metadata.version("lerobot"),
        "episodes": data.num_episodes,
        "frames": data.num_frames,
        "task": data[0]["task"],
        "same": same,
        "loss": round(loss, 3),
        "seconds": round(time.perf_counter() - began, 1),
    }
    print(json.dumps(result))
    assert all(same.values()) and np.isfinite(loss)


if __name__ == "__main__":
    main()
