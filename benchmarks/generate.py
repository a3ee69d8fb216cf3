"""Checked demonstrations per hour, with and without pictures, by one and by several processes.

    python benchmarks/generate.py [--task lift_barrier] [--episodes 8] [--workers 2] [--size 320 240]

All variants make the same seeds, one after the other, in one run; the start-up of processes and renderers is
not timed. The last line is JSON: successful episodes per hour, and the ratios.
"""

import argparse
import json
import time
from functools import partial
from pathlib import Path

from omegaconf import OmegaConf

from rf_exp.datagen import Settings, generate, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.tasks import load_task
from rf_exp.types import NO_PICTURES, ConstraintSet, Pictures

CONF = Path(__file__).resolve().parents[1] / "conf" / "task"


def per_hour(settings: Settings, pictures: Pictures, episodes: int, workers: int) -> float:
    """Successful episodes per hour of wall time."""
    make = partial(make_episode, settings, pictures)
    outcomes = generate(make, [*range(workers), *range(episodes)], workers)
    for _ in range(workers):
        next(outcomes)  # starts processes and renderers
    began = time.perf_counter()
    made = sum(outcome.success for outcome in outcomes)
    return made / (time.perf_counter() - began) * 3600


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="lift_barrier")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="width and height in pixels")
    given = parser.parse_args()
    node = OmegaConf.to_object(OmegaConf.load(CONF / f"{given.task}.yaml"))
    assert isinstance(node, dict)
    settings = Settings.configured(
        load_task(given.task, node[given.task]), ConstraintSet("full"), ScriptedSpec()
    )
    width, height = given.size
    found = {
        f"{what}_{workers}": round(per_hour(settings, pictures, given.episodes, workers))
        for workers in (1, given.workers)
        for what, pictures in (
            ("states", NO_PICTURES),
            ("pictures", Pictures(width, height, render=True, cameras="all")),
        )
    }
    ratios = {
        "states_over_pictures": found["states_1"] / found["pictures_1"],
        "workers": found[f"states_{given.workers}"] / found["states_1"],
        "workers_with_pictures": found[f"pictures_{given.workers}"] / found["pictures_1"],
    }
    per_hour_of = {"task": given.task, "episodes": given.episodes, "episodes_per_hour": found}
    print(json.dumps(per_hour_of | {name: round(value, 2) for name, value in ratios.items()}))


if __name__ == "__main__":
    main()
