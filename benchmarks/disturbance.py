"""Disturbed demonstrations: how many seeds they lose, how fast they are, how far they deviate from the plan.

    python benchmarks/disturbance.py [--tasks lift_barrier,place_food] [--first 5000] [--seeds 25]

Without pictures, with the disturbance and the delays of the recipe `fast`, in one process. One line per task:
largest velocity and acceleration of the commands, the share of steps of agents that do not hesitate in which
some joint deviates by more than a milliradian, and by how much in these (medians, 90th and 99th
percentiles). The last line is JSON; the figures are in docs/component_studies.md.
"""

import argparse
import json
from typing import Any

import numpy as np
from hydra import compose, initialize_config_dir
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.command import CONF, register_all_tasks
from rf_exp.datagen import Settings, make_episode
from rf_exp.experiment import read_experiment
from rf_exp.policy.inputs.coordination import held_up_mask
from rf_exp.types import ARM_JOINTS, CONTROL_HZ, NO_PICTURES, Episode

FAST = ("policy=fast", "recipe=fast", "render=false", "stages=[generate]")
DEVIATION_RAD = 1e-3
PERCENTILES = (50, 90, 99)


def largest_rates(commands: NDArray[np.float32]) -> tuple[float, float]:
    """The largest velocity in rad/s and acceleration in rad/s2 of any joint in commands (T, N, 8)."""
    velocity = np.diff(commands[..., :ARM_JOINTS].astype(float), axis=0) * CONTROL_HZ
    return float(np.abs(velocity).max()), float(np.abs(np.diff(velocity, axis=0)).max() * CONTROL_HZ)


def deviations(settings: Settings, episode: Episode) -> NDArray[np.float64]:
    """Deviations (K, 2) of the worst joint in rad and of the TCP in m, in steps without hesitation."""
    action, executed = (commands.astype(float) for commands in (episode.action, episode.commanded))
    joints = np.abs(executed - action)[..., :ARM_JOINTS].max(axis=2)
    tcp_deviations = [
        np.linalg.norm(
            np.subtract(*(arm.tcp(commands[:, k])[:, :3, 3] for commands in (executed, action))), axis=1
        )
        for k, arm in enumerate(settings.task.arms.values())
    ]
    return np.stack([joints, np.stack(tcp_deviations, axis=1)], axis=2)[~held_up_mask(action, executed)]


def measure(settings: Settings, seeds: range) -> dict[str, Any]:
    """Results of the seeds of one task."""
    outcomes = [make_episode(settings, NO_PICTURES, seed) for seed in seeds]
    episodes = [outcome.episode for outcome in outcomes if outcome.episode is not None]
    deviations_ = np.concatenate([deviations(settings, episode) for episode in episodes])
    deviating = deviations_[:, 0] > DEVIATION_RAD
    return {
        "succeeded": len(episodes),
        "lost": {outcome.seed: outcome.reason for outcome in outcomes if outcome.episode is None},
        "action": np.max([largest_rates(episode.action) for episode in episodes], axis=0).tolist(),
        "executed": np.max([largest_rates(episode.commanded) for episode in episodes], axis=0).tolist(),
        "measured_rad_s": max(float(np.abs(episode.qvel[..., :ARM_JOINTS]).max()) for episode in episodes),
        "off": float(deviating.mean()),
        "off_rad": np.percentile(deviations_[deviating, 0], PERCENTILES).tolist(),
        "off_m": np.percentile(deviations_[deviating, 1], PERCENTILES).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default="all", help="separated by commas")
    parser.add_argument("--first", type=int, default=5000)
    parser.add_argument("--seeds", type=int, default=25, help="consecutive ones")
    args = parser.parse_args()
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("config", [*FAST, "task=all"])
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore[reportArgumentType]
    results = {}
    for task in experiment.tasks:
        if args.tasks != "all" and task.name not in args.tasks.split(","):
            continue
        settings = experiment.settings(task, experiment.constraint_sets[0])
        results[task.name] = result = measure(settings, range(args.first, args.first + args.seeds))
        radians, metres = (" ".join(f"{value:.3f}" for value in result[key]) for key in ("off_rad", "off_m"))
        print(
            f"{task.name}: {result['succeeded']} of {args.seeds}; action {result['action'][0]:.3f} rad/s "
            f"{result['action'][1]:.3f} rad/s2, executed {result['executed'][0]:.3f} "
            f"{result['executed'][1]:.2f}, measured {result['measured_rad_s']:.3f} rad/s; "
            f"off in {100 * result['off']:.0f} %: {radians} rad, {metres} m",
            *(f"  lost {seed}: {reason}" for seed, reason in result["lost"].items()),
            sep="\n",
            flush=True,
        )
    print(
        json.dumps({"benchmark": "disturbance", "first": args.first, "seeds": args.seeds, "tasks": results})
    )


if __name__ == "__main__":
    main()
