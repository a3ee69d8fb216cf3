"""Cost of an episode relative to its physics: the same commands are stepped again from the same start.

    python benchmarks/episode.py [--tasks lift_barrier,take_photo] [--seeds 3]

Undisturbed episodes of the expert on seeds 0, 1, .. without pictures: plan, checks, simulation, monitor. Then
the simulator is reset and steps the commands of the episode once more, without anything else. CPU time of one
core, both in one run; one line per task, the last line is JSON.
"""

import argparse
import time
from statistics import mean

from each_task import measure_each

from rf_exp.datagen import EpisodeGenerator, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


def measure(task: Task, seeds: int) -> dict[str, float]:
    """Mean CPU seconds of an episode, including the reset, and of its commands alone.

    Raises ArgumentError for a seed without an episode.
    """
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    episodes_s, physics_s = [], []
    with Simulator(task, render=False) as world:
        for seed in range(-1, seeds):  # the first one fills caches
            began = time.process_time()
            generator = EpisodeGenerator(settings, CameraSubset(world), settings.make_brain(max(seed, 0)))
            outcome = generator.make(max(seed, 0))
            episodes_s.append(time.process_time() - began)
            if outcome.episode is None:
                raise ArgumentError(f"{task.name}, seed {seed}: {outcome.reason}")
            world.reset(max(seed, 0))
            began = time.process_time()
            for command in outcome.episode.action.astype(float):
                world.step(command)
            physics_s.append(time.process_time() - began)
    result = {"episode_s": mean(episodes_s[1:]), "physics_s": mean(physics_s[1:])}
    result["ratio"] = result["episode_s"] / result["physics_s"]
    return {key: round(value, 3) for key, value in result.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    measure_each(parser, measure, seeds=3)


if __name__ == "__main__":
    main()
