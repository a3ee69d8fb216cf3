"""Reads an export with robomimic: compares values with the store, checks the split, trains on one batch.

    PYTHON benchmarks/robomimic_reads.py EXPORT STORE

PYTHON belongs to a separate environment with robomimic and zarr. The last line is JSON.
"""

# pyright: reportMissingImports=false
import argparse
import json
import time
from collections import OrderedDict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr
from robomimic.algo import algo_factory
from robomimic.config import config_factory
from robomimic.utils import obs_utils
from robomimic.utils.dataset import SequenceDataset

HORIZON = 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("export", type=Path)
    parser.add_argument("store", type=Path)
    parser.add_argument("--rows", type=int, default=60, help="to compare")
    args = parser.parse_args()
    began = time.perf_counter()
    store = zarr.open_group(args.store, mode="r")
    arrays: Any = store["data"]
    cameras = {f"{name}_image": f"rgb_{name}" for name in store.attrs["cameras"]}  # pyright: ignore
    obs_utils.initialize_obs_utils_with_obs_specs(
        {"obs": {"low_dim": ["qpos", "qvel"], "rgb": [*cameras]}}  # pyright: ignore
    )
    data, train_part, valid_part = (
        SequenceDataset(
            hdf5_path=str(args.export / "demonstrations.hdf5"),
            obs_keys=("qpos", "qvel", *cameras),
            dataset_keys=("actions", "rewards", "dones"),
            seq_length=HORIZON,
            load_next_obs=False,
            hdf5_cache_mode=None,
            filter_by_attribute=part,
        )
        for part in (None, "train", "valid")
    )
    parts = {"train": train_part.n_demos, "valid": valid_part.n_demos}
    assert {*train_part.demos} | {*valid_part.demos} == {*data.demos} and sum(parts.values()) == data.n_demos
    rows = np.unique(np.linspace(0, len(data) - 1, args.rows).astype(int)).tolist()
    same = {name: True for name in ("actions", "qpos", "qvel", *cameras)}
    stored = {"actions": "action", "qpos": "qpos", "qvel": "qvel", **cameras}
    for row in rows:
        item = data[row]
        for name in same:
            actual = (item if name == "actions" else item["obs"])[name][0]
            expected = np.asarray(arrays[stored[name]][row])
            same[name] &= np.array_equal(actual, expected if name in cameras else expected.ravel())
    loss = train(data, cameras)
    result = {
        "robomimic": metadata.version("robomimic"),
        "episodes": data.n_demos,
        **parts,
        "frames": len(data),
        "same": same,
        "loss": round(loss, 3),
        "seconds": round(time.perf_counter() - began, 1),
    }
    print(json.dumps(result))
    assert all(same.values()) and np.isfinite(loss)


def train(data: SequenceDataset, cameras: dict[str, str]) -> float:
    """Trains behaviour cloning for one step on one batch; returns the loss."""
    config = config_factory("bc")
    with config.values_unlocked():
        config.observation.modalities.obs.low_dim = ["qpos", "qvel"]
        config.observation.modalities.obs.rgb = [*cameras]
    obs_utils.initialize_obs_utils_with_config(config)
    item = data[0]
    shapes = OrderedDict(
        (name, [value.shape[-1], *value.shape[1:-1]] if name in cameras else list(value.shape[1:]))
        for name, value in item["obs"].items()
    )
    model = algo_factory("bc", config, shapes, item["actions"].shape[-1], torch.device("cpu"))
    model.set_train()
    batch = next(iter(torch.utils.data.DataLoader(data, 8, shuffle=True)))
    batch = model.postprocess_batch_for_training(model.process_batch_for_training(batch), None)
    return float(model.train_on_batch(batch, epoch=0)["losses"]["action_loss"])


if __name__ == "__main__":
    main()
