"""Cost of the parts of an experiment in CPU seconds of one core: the figures of rf_exp/stages/costs.yaml.

    python benchmarks/costs.py [outputs/data/lift_barrier/full/fast.zarr] [--seeds 4] [--states]

Makes the first seeds of every task with the pictures of all agents, and takes a few steps of each phase of
learning from a store; the time of a scene of evaluation is read from the rows in results/. Prints the YAML.
With `--states` only the cost of episodes of the paper's recipe without pictures (docs/expert.md).
"""

import argparse
import time
from pathlib import Path
from statistics import median

import numpy as np
import torch
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.ablation import load, without_variation
from rf_exp.command import CONF, register_all_tasks
from rf_exp.datagen import make_episode
from rf_exp.experiment import Experiment, read_experiment
from rf_exp.policy import Training, Windows, views
from rf_exp.store import Store

DEMO = Path("outputs/data/lift_barrier/full/fast.zarr")
ROOT = Path(__file__).resolve().parents[1]
STEPS = 20  # of each fit
# The keys with the numbers of steps of the phases.
FITS = "policy.encoder.keypoints.steps", "policy.head.refined.regression_steps", "training.steps"


def demonstrations_s(experiment: Experiment, seeds: int) -> dict[str, float]:
    """Task -> CPU seconds per demonstration, including seeds that fail."""
    seconds_by_task = {}
    for task in experiment.tasks:
        settings = experiment.settings(task, experiment.constraint_sets[0])
        make_episode(settings, experiment.pictures, seeds)  # starts the renderer
        began = time.process_time()
        successes = sum(make_episode(settings, experiment.pictures, seed).success for seed in range(seeds))
        seconds_by_task[task.name] = (time.process_time() - began) / max(1, successes)
    return seconds_by_task


def learning_s(experiment: Experiment, store: Store) -> dict[str, float]:
    """Phase -> CPU seconds per step; `once` is the cost of one-time work, such as encoding all pictures."""
    torch.set_num_threads(1)
    view = views(experiment.archs[0], store.agents)[0]
    windows = Windows(store, view, experiment.policy, torch.device("cpu"))
    training = Training(windows, view, experiment.policy, experiment.training)
    times_s = [time.process_time()]
    while not training.done:
        training.step()
        times_s.append(time.process_time())
    step_s = np.diff(times_s).reshape(len(FITS), STEPS)
    median_s = np.median(step_s, axis=1)
    return {
        "once": float((step_s - median_s[:, None])[:, [0, -1]].sum()),
        **dict(zip(FITS, median_s.tolist(), strict=True)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, nargs="?", default=DEMO, help="default: that of the demo")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--states", action="store_true", help="episodes without pictures and disturbances")
    args = parser.parse_args()
    register_all_tasks()
    states = ["policy=paper", "recipe=paper", "render=false", "stages=[generate]"]
    fast = ["profile=laptop", "recipe=fast", *(f"{key}={STEPS}" for key in FITS)]
    overrides = [*(states if args.states else fast), "task=all"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("config", overrides)
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True), overrides)  # pyright: ignore[reportArgumentType]
    if args.states:
        demonstration_s = demonstrations_s(experiment, args.seeds)
        print(
            yaml.safe_dump(
                {task: round(seconds, 2) for task, seconds in demonstration_s.items()}, sort_keys=False
            )
        )
        return
    evaluated = [row for row in without_variation(load(ROOT)).evaluation if row.recipe == experiment.recipe]
    tasks = {}
    for task, made_s in demonstrations_s(experiment, args.seeds).items():
        scenes = [row.wall_s for row in evaluated if row.task == task]
        tasks[task] = {"demonstration_s": round(made_s, 1), "scene_s": round(median(scenes or [1.0]), 1)}
    store = Store.open(args.store)
    learning = {phase: round(seconds, 4) for phase, seconds in learning_s(experiment, store).items()}
    print(yaml.safe_dump({experiment.recipe: {"learning_s": learning, "tasks": tasks}}, sort_keys=False))


if __name__ == "__main__":
    main()
