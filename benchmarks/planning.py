"""Cost of a plan: CPU time and length of the first plan of every task, without simulation.

    python benchmarks/planning.py [--tasks place_food,pass_shoe] [--seeds 20]

From proposal to checked plan: motion, schedule, checks. One line per task: mean CPU time of a plan, its mean
length in control steps until the last arm is home, and the number of seeds without a plan. The last line is
JSON. To compare two versions, run both one after the other, each in its own checkout.
"""

import argparse
import time

import numpy as np
from each_task import measure_each

from rf_exp.datagen import Planned, Planner, Settings
from rf_exp.datagen.brain import Question, ScriptedSpec
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


def measure(task: Task, seeds: int) -> dict[str, float]:
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    plan_s, steps = [], []
    with Simulator(task, render=False) as simulator:
        for seed in range(-1, seeds):  # the first one fills caches
            scene = simulator.reset(max(seed, 0))
            planner, question = (
                Planner(settings, settings.make_brain(max(seed, 0))),
                Question(task, scene, {}, (), ()),
            )
            began = time.process_time()
            plan = planner.plan(question, scene, np.random.default_rng([max(seed, 0), 1]))
            if seed >= 0:
                plan_s.append(time.process_time() - began)
                steps += [len(plan.schedule.positions)] if isinstance(plan, Planned) else []
    return {
        "plan_s": round(float(np.mean(plan_s)), 3),
        "steps": round(float(np.mean(steps)), 1),
        "without": seeds - len(steps),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    measure_each(parser, measure, seeds=20)


if __name__ == "__main__":
    main()
