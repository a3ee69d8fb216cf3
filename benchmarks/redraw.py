"""Cost of rendering a demonstration in another appearance, in CPU seconds of one core.

    python benchmarks/redraw.py [--tasks place_food] [--seeds 4] [--copies 4]

Makes demonstrations of the recipe `fast`, with the pictures of all agents (128x96), and renders each again
with the appearance and light of the variation `full`. Ends with JSON: seconds of both, pictures per second,
and the ratio, of one run.
"""

import argparse
import json
import time
from dataclasses import replace
from statistics import median
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.command import CONF, register_all_tasks
from rf_exp.datagen import make_episode
from rf_exp.experiment import Experiment, read_experiment
from rf_exp.sim import Simulator
from rf_exp.stages.redrawing import render_copy
from rf_exp.tasks import PHYSICAL_KEYS, read_variation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default="place_food")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--copies", type=int, default=4)
    args = parser.parse_args()
    results = {}
    for name in args.tasks.split(","):
        results[name] = measure(composed(name), args.seeds, args.copies)
        print(f"{name}: {results[name]}")
    print(json.dumps({**results, "ratio": round(median(result["ratio"] for result in results.values()), 3)}))


def composed(task: str) -> Experiment:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("config", ["recipe=fast", "profile=laptop", f"task={task}"])
    values: Any = OmegaConf.to_container(config, resolve=True)
    return read_experiment(values)


def measure(experiment: Experiment, seeds: int, copies: int) -> dict[str, float]:
    (task,), pictures = experiment.tasks, experiment.pictures
    settings = experiment.settings(task, experiment.constraint_sets[0])
    make_episode(settings, pictures, seeds)  # starts the renderer
    began, episodes = time.process_time(), []
    for seed in range(seeds):
        outcome = make_episode(settings, pictures, seed)
        episodes += [outcome.episode] if outcome.episode is not None else []
    demonstration_s = (time.process_time() - began) / len(episodes)
    full = read_variation("full")
    variation = replace(full, **{name: getattr(task.variation, name) for name in PHYSICAL_KEYS})
    varied = replace(task, variation=variation)
    with Simulator(varied, width_px=pictures.width, height_px=pictures.height) as world:
        render_copy(world, episodes[0], varied, 1)
        began, pictures_rendered = time.process_time(), 0
        for episode in episodes:
            for copy in range(1, copies + 1):
                copied_episode = render_copy(world, episode, varied, copy)
                pictures_rendered += sum(len(frames) for frames in copied_episode.images.values())
    total_s = time.process_time() - began
    copy_s = total_s / (len(episodes) * copies)
    return {
        "demonstration_s": round(demonstration_s, 3),
        "copy_s": round(copy_s, 3),
        "pictures_a_second": round(pictures_rendered / total_s, 1),
        "ratio": round(copy_s / demonstration_s, 3),
    }


if __name__ == "__main__":
    main()
