"""The folder of a policy: configuration, weights with normaliser, curves; never a pickle.

config.json         policy, view, train, data: what made it; written before training starts
model.safetensors   averaged weights and normaliser; there once training is finished
curves.csv          loss and learning rate over the steps
state.safetensors   what an interrupted training goes on from; removed at the end
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.diffusion import DiffusionPolicy
from rf_exp.policy.views import Stream, View

CONFIG, MODEL, CURVES, STATE = "config.json", "model.safetensors", "curves.csv", "state.safetensors"


def device_of(name: str) -> torch.device:
    """`auto` is the GPU where there is one. Raises ArgumentError for cuda without one."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ArgumentError("device is 'cuda', but torch finds no CUDA GPU; use device=cpu or device=auto")
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Replace a safetensors file in one go: a reader sees the old one or the new one."""
    partial = path.with_suffix(".partial")
    save_file({k: v.detach().contiguous() for k, v in tensors.items()}, partial, dict(metadata))
    os.replace(partial, path)


def claim(folder: Path, made_of: Mapping[str, Any]) -> bool:
    """Take a folder for a training made of these values; whether it is finished there already.

    Raises StageError naming the keys that differ when the folder holds another training.
    """
    wanted = json.loads(json.dumps(made_of))
    path = folder / CONFIG
    if path.exists():
        differing = _differences(json.loads(path.read_text()), wanted)
        if differing:
            raise StageError(
                f"{folder} holds a policy of another configuration; differing: {'; '.join(differing)}; "
                "delete the folder or choose another `out`"
            )
    else:
        folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(wanted, indent=2) + "\n")
        os.replace(partial, path)
    return (folder / MODEL).exists()


def load_policy(folder: Path, device: str = "auto") -> tuple[DiffusionPolicy, View]:
    """A trained policy, ready to act, and the view it commands. Raises StageError where none is."""
    if not (folder / MODEL).exists():
        raise StageError(
            f"no trained policy in {folder}: {MODEL} is missing; train it first (stages=[train])"
        )
    made_of = json.loads((folder / CONFIG).read_text())
    streams = (Stream(stream["camera"], tuple(stream["agents"])) for stream in made_of["view"]["streams"])
    view = View(made_of["view"]["name"], tuple(streams))
    policy = DiffusionPolicy(PolicyConfig(**made_of["policy"]), view.proprio_size, view.action_size)
    policy.load_state_dict(load_file(folder / MODEL))
    return policy.to(device_of(device)).eval(), view


def _differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """`key: found x, wanted y` for every leaf that differs."""
    old, new = _leaves(found), _leaves(wanted)
    keys = [key for key in sorted(old.keys() | new.keys()) if old.get(key) != new.get(key)]
    return [f"{key}: found {old.get(key, 'nothing')}, wanted {new.get(key, 'nothing')}" for key in keys]


def _leaves(value: Any, key: str = "") -> dict[str, str]:
    if isinstance(value, Mapping):
        nested = (_leaves(item, f"{key}.{name}" if key else str(name)) for name, item in value.items())
        return {path: text for leaves in nested for path, text in leaves.items()}
    return {key: json.dumps(value)}
