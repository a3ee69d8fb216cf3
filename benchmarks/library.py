"""Success rate of the library's plans in ManiSkill's own two-robot tasks, by ManiSkill's criterion.

    python benchmarks/library.py [--scenes 100] [--seed 0] [--tasks TwoRobotPickCube-v1,...] [--slow]

The scenes are those of consecutive seeds from `--seed`, all counted; a scene is a success by the last
`info["success"]` of its environment. There is no replanning. The jobs are those of
examples/library/two_robots.py. With `--slow` arms move within the limits of our demonstrations, 0.9 rad/s
and 0.9 rad/s2. Prints a table; the last line is JSON: for each task the rate with Wilson's 95 % interval,
successes within ManiSkill's default limit of 100 steps, steps, and the CPU seconds of an episode, planning
and simulation included.
"""

import argparse
import json
import runpy
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.ablation import wilson
from rf_exp.errors import unknown_choice
from rf_exp.library import JointLimits, NoPlan
from rf_exp.tasks import default_of

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "library" / "two_robots.py"
OWN_LIMIT = 100  # control steps, in ManiSkill's registration of both tasks


def measure(example: dict[str, Any], name: str, seeds: range, slow: bool) -> dict[str, Any]:
    """Results of the scenes of a task."""
    env, steps, reasons, seconds = example["make"](name), [], Counter[str](), []
    limits = JointLimits(**default_of("limits")) if slow else example["LIMITS"]
    for seed in seeds:
        began = time.process_time()
        result = example["play"](env, seed, example["JOBS"][name], limits)
        seconds.append(time.process_time() - began)
        if isinstance(result, NoPlan):
            reasons[str(result)] += 1
        elif result.success:
            steps.append(result.steps)
        else:
            reasons[result.reason] += 1
    env.close()
    for reason, count in reasons.most_common():
        print(f"{name}: {count} x {reason}")
    rate = wilson(len(steps), len(seeds))
    return {
        "first_seed": seeds.start,
        "scenes": len(seeds),
        "success": len(steps),
        "low": round(rate.low, 3),
        "high": round(rate.high, 3),
        "within_100_steps": int(sum(step <= OWN_LIMIT for step in steps)),
        "steps": float(np.median(steps)) if steps else None,
        "most_steps": max(steps, default=None),
        "core_s": round(float(np.median(seconds)), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    example = runpy.run_path(str(EXAMPLE))
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--tasks", default=",".join(example["JOBS"]))
    parser.add_argument("--slow", action="store_true")
    args = parser.parse_args()
    results, seeds = {}, range(args.seed, args.seed + args.scenes)
    for name in args.tasks.split(","):
        if name not in example["JOBS"]:
            raise unknown_choice("task", name, example["JOBS"])
        results[name] = measure(example, name, seeds, args.slow)
    print("| task | success | 95 % | within 100 steps | steps | longest | core s an episode |")
    print("|---|---|---|---|---|---|---|")
    for name, row in results.items():
        low, high = (f"{100 * row[end]:.1f}" for end in ("low", "high"))
        rate = f"{row['success']} of {row['scenes']}"
        within = row["within_100_steps"]
        print(
            f"| {name} | {rate} | {low} to {high} % | {within} | {row['steps']} | {row['most_steps']} | "
            f"{row['core_s']} |"
        )
    print(json.dumps({"benchmark": "library", "slow": args.slow, **results}))


if __name__ == "__main__":
    main()
