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
    successes = sum(outcome.success for outcome in outcomes)
    return successes / (time.perf_counter() - began) * 3600


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="lift_barrier")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="width and height in pixels")
    args = parser.parse_args()
    config = OmegaConf.to_object(OmegaConf.load(CONF / f"{args.task}.yaml"))
    assert isinstance(config, dict)
    settings = Settings.configured(
        load_task(args.task, config[args.task]), ConstraintSet("full"), ScriptedSpec()
    )
    width, height = args.size
    rates = {
        f"{kind}_{workers}": round(per_hour(settings, pictures, args.episodes, workers))
        for workers in (1, args.workers)
        for kind, pictures in (
            ("states", NO_PICTURES),
            ("pictures", Pictures(width, height, render=True, cameras="all")),
        )
    }
    ratios = {
        "states_over_pictures": rates["states_1"] / rates["pictures_1"],
        "workers": rates[f"states_{args.workers}"] / rates["states_1"],
        "workers_with_pictures": rates[f"pictures_{args.workers}"] / rates["pictures_1"],
    }
    per_hour_of = {"task": args.task, "episodes": args.episodes, "episodes_per_hour": rates}
    print(json.dumps(per_hour_of | {name: round(value, 2) for name, value in ratios.items()}))


if __name__ == "__main__":
    main()
