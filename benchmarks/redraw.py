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
from rf_exp.stages.redrawing import copied
from rf_exp.tasks import PHYSICAL, read_variation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default="place_food")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--copies", type=int, default=4)
    given = parser.parse_args()
    found = {}
    for name in given.tasks.split(","):
        found[name] = measured(asked(name), given.seeds, given.copies)
        print(f"{name}: {found[name]}")
    print(json.dumps({**found, "ratio": round(median(each["ratio"] for each in found.values()), 3)}))


def asked(task: str) -> Experiment:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        node = compose("config", ["recipe=fast", "profile=laptop", f"task={task}"])
    plain: Any = OmegaConf.to_container(node, resolve=True)
    return read_experiment(plain)


def measured(experiment: Experiment, seeds: int, copies: int) -> dict[str, float]:
    (task,), pictures = experiment.tasks, experiment.pictures
    settings = experiment.settings(task, experiment.constraint_sets[0])
    make_episode(settings, pictures, seeds)  # starts the renderer
    began, episodes = time.process_time(), []
    for seed in range(seeds):
        made = make_episode(settings, pictures, seed)
        episodes += [made.episode] if made.episode is not None else []
    demonstration_s = (time.process_time() - began) / len(episodes)
    full = read_variation("full")
    shown = replace(full, **{name: getattr(task.variation, name) for name in PHYSICAL})
    varied = replace(task, variation=shown)
    with Simulator(varied, width_px=pictures.width, height_px=pictures.height) as world:
        copied(world, episodes[0], varied, 1)
        began, taken = time.process_time(), 0
        for episode in episodes:
            for copy in range(1, copies + 1):
                again = copied(world, episode, varied, copy)
                taken += sum(len(each) for each in again.images.values())
    spent_s = time.process_time() - began
    copy_s = spent_s / (len(episodes) * copies)
    return {
        "demonstration_s": round(demonstration_s, 3),
        "copy_s": round(copy_s, 3),
        "pictures_a_second": round(taken / spent_s, 1),
        "ratio": round(copy_s / demonstration_s, 3),
    }


if __name__ == "__main__":
    main()
