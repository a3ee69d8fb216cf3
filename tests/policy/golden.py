"""Digests of six small trainings and of the commands of their policies, in golden.json beside this file.

    python -m tests.policy.golden            computes and writes them, half a minute of one core
    python -m tests.policy.golden --show     prints them and writes nothing

They show whether a refactoring changes learning: weights are compared as a set, whatever their names.
Initial weights depend on the order in which networks are built, so a changed order shows too. If a digest
changes, learning gives other policies than before: raise LEARNER in rf_exp/policy/config.py, then compute
them anew.

PyTorch and its libraries use kernels that any processor with AVX2 has (`KERNELS`). If bytes differ anyway, on
another kind of processor than the one named in the file, losses must be as recorded.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.artifacts import write_json
from tests.golden import processor

FILE = Path(__file__).with_name("golden.json")
# For PyTorch, oneDNN and MKL, by their documentation: "CPU capability", "CPU dispatcher control" and
# "Conditional Numerical Reproducibility".
KERNELS = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "MKL_CBWR": "AVX2",
    "OMP_NUM_THREADS": "1",
}
AGENTS, EPISODES, HELD_OUT = 2, 2, 100  # episodes for training, and the seed of a held-out one
COMMANDS = 20  # recorded control steps of the runner
_ALL = ("training.batch_size=8", "training.warmup_steps=2", "training.device=cpu")
_ENCODER, _HEAD = "policy.encoder.keypoints", "policy.head"
_SMALL = (
    *(f"{_ENCODER}.steps=4", f"{_HEAD}.refined.regression_steps=5", "training.steps=4"),
    f"{_HEAD}.regression.hidden=[32,32]",
)
_UNET = f"{_HEAD}.diffusion.channels=[8,16]"
_PERCEPTRON = (*_SMALL, f"{_HEAD}.diffusion.trunk=[16]", _UNET, f"{_HEAD}.diffusion.noise_draws=2")
RECIPES: dict[str, tuple[str, ...]] = {
    "fast": _PERCEPTRON,
    "state": _PERCEPTRON,
    "diffusion_alone": (*_PERCEPTRON, "policy.phases=false"),
    "without_phases": _PERCEPTRON,
    "crop_refinement": (*_PERCEPTRON, f"{_ENCODER}.crop_refinement=8", f"{_ENCODER}.shift_px=4"),
    "paper": ("training.epochs=null", "training.steps=3", _UNET),
}
Digests = dict[str, Any]


def digests_of(recipe: str, folder: Path) -> Digests:
    """Digests of one recipe: weights, commands, and the losses of its steps."""
    import torch

    from rf_exp.policy import MODEL, DiffusionRunner, load_policy, train, views
    from rf_exp.policy.learning.checkpoint import read_tensors
    from rf_exp.store import Store
    from tests.conftest import RECIPES as CHOICES
    from tests.conftest import experiment
    from tests.policy.conftest import ARCHS, HEIGHT, WIDTH, make_episode, rows, scene_at, shown, write_store

    torch.set_num_threads(1)
    picture = f"picture={{width: {WIDTH}, height: {HEIGHT}}}"
    configured = experiment(f"policy={CHOICES[recipe]}", picture, *_ALL, *RECIPES[recipe])
    store = Store.open(write_store(folder / "reach.zarr", AGENTS, EPISODES))
    view = views(ARCHS[-1], AGENTS)[0]
    made = train(store, view, configured.policy, replace(configured.training, log_every=1), folder / recipe)
    tensors, _ = read_tensors(made / MODEL)
    policy, view, spec = load_policy(made, "cpu")
    learned = {name for name, _ in policy.named_parameters()}
    weights = sorted(_sha(tensors[name].numpy()) for name in learned)
    runner, episode = DiffusionRunner(policy, view, spec), make_episode(HELD_OUT, AGENTS)
    runner.reset(HELD_OUT)
    commands = []
    for step in range(COMMANDS):
        pictures = {camera: frames[step] for camera, frames in episode.images.items()}
        commands.append(runner(shown(runner, scene_at(episode, step), pictures)))
    return {
        "weights": _sha(np.array(weights)),
        "commands": _sha(np.stack(commands).astype(np.float32)),
        "losses": [float(f"{float(row['loss']):.5g}") for row in rows(made)],
    }


def _sha(values: np.ndarray) -> str:
    return hashlib.sha256(f"{values.dtype} {values.shape}".encode() + values.tobytes()).hexdigest()[:16]


def current_digests() -> Digests:
    """The digests of the present code, computed in a process of its own with `KERNELS`."""
    command = [sys.executable, "-m", "tests.policy.golden", "--show"]
    root = Path(__file__).parents[2]
    done = subprocess.run(
        command, cwd=root, env={**os.environ, **KERNELS}, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def _show() -> None:
    from rf_exp.policy import LEARNER

    with tempfile.TemporaryDirectory() as folder:
        recipes = {recipe: digests_of(recipe, Path(folder) / recipe) for recipe in RECIPES}
    print(json.dumps({"processor": processor(), "learner": LEARNER, "recipes": recipes}))


def main() -> int:
    parser = argparse.ArgumentParser("python -m tests.policy.golden", description="Takes the digests anew.")
    parser.add_argument("--show", action="store_true", help="print them in one line, and write nothing")
    if parser.parse_args().show:
        _show()
        return 0
    write_json(FILE, current_digests())
    return 0


if __name__ == "__main__":
    sys.exit(main())
