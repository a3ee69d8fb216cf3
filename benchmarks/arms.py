"""Scaling of planning, success and schedules with the number of arms: ring, tower, chain and lift.

    python benchmarks/arms.py [--families ring,tower] [--arms 1,8] [--things 1,2] [--seeds 20] [--out FOLDER]

Seeds 0, 1, .. of each family with each number of arms and of objects, undisturbed, without pictures. One row
per seed in FOLDER/rows.jsonl, which a further run continues; each cell has a process of its own. Times are
CPU seconds: motion, schedule (with its diagrams), checks, the simulator's steps, and the whole episode. The
last line is JSON: for each cell the means of these, successes, contacts, makespan against the proven bound,
and peak memory; for each family the exponent by which planning grows with the number of arms, from 2 on.
"""

import argparse
import json
import resource
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from rf_exp.constraints import RoboChecker
from rf_exp.datagen import EpisodeGenerator, Settings, Trace, planning
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import CONFIGURED, Task, named_task
from rf_exp.types import ConstraintSet

FAMILIES = tuple(sorted(path.stem for path in (CONFIGURED / "family").glob("*.yaml")))
TIMED_PARTS = ("motion_s", "schedule_s", "checks_s", "physics_s", "episode_s")
Row = dict[str, Any]


@contextmanager
def timed(spent: dict[str, float]) -> Iterator[None]:
    """Context that adds the CPU seconds of the parts of an episode to `spent`."""
    with (
        patch.object(planning, "plan_motion", _clocked(planning.plan_motion, spent, "motion_s")),
        patch.object(RoboChecker, "schedule", _clocked(RoboChecker.schedule, spent, "schedule_s")),
        patch.object(RoboChecker, "check", _clocked(RoboChecker.check, spent, "checks_s")),
        patch.object(Simulator, "step", _clocked(Simulator.step, spent, "physics_s")),
    ):
        yield


def _clocked(work: Callable[..., Any], spent: dict[str, float], key: str) -> Callable[..., Any]:
    def clocked(*arguments: Any, **keywords: Any) -> Any:
        began = time.process_time()
        try:
            return work(*arguments, **keywords)
        finally:
            spent[key] += time.process_time() - began

    return clocked


def one(world: Simulator, task: Task, seed: int) -> Row:
    """Row of the episode of one seed."""
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    spent: dict[str, float] = dict.fromkeys(TIMED_PARTS, 0.0)
    trace = Trace()
    began = time.process_time()
    with timed(spent):
        outcome = EpisodeGenerator(settings, CameraSubset(world), settings.make_brain(seed), trace).make(seed)
    spent["episode_s"] = time.process_time() - began
    plans = [plan.schedule for plan, _ in trace.executions()]
    row = {"seed": seed, "success": outcome.success, "steps": outcome.steps, "attempts": outcome.attempts}
    row |= {"contacts": outcome.contacts, "makespan": sum(map(len, plans))}
    row |= {"bound": sum(plan.makespan_bound for plan in plans)}
    row |= {key: round(value, 3) for key, value in spent.items()}
    return row if outcome.success else {**row, "reason": outcome.reason}


def cell(name: str, seeds: list[int], path: str) -> None:
    """Runs seeds of a task and writes each row at once; the first seed is also run before, to fill caches."""
    task = named_task(name)
    assert task is not None
    with Simulator(task, render=False) as world, Path(path).open("a", encoding="utf-8") as rows:
        one(world, task, seeds[0])
        for seed in seeds:
            row = {"task": name, **one(world, task, seed)}
            row["peak_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
            print(json.dumps(row), file=rows, flush=True)


def summary(rows: list[Row]) -> Row:
    """Means over the seeds of a cell."""
    bound = sum(row["bound"] for row in rows)
    return {
        "seeds": len(rows),
        "success": sum(row["success"] for row in rows),
        "first": sum(row["success"] and row["attempts"] == 1 for row in rows),
        "contacts": sum(row["contacts"] for row in rows),
        "steps": round(float(np.mean([row["steps"] for row in rows])), 1),
        "over_bound": round(sum(row["makespan"] for row in rows) / bound - 1, 4) if bound else None,
        **{key: round(float(np.mean([row[key] for row in rows])), 3) for key in TIMED_PARTS},
        "peak_mb": max(row["peak_mb"] for row in rows),
    }


def exponent(cells: dict[int, Row]) -> float | None:
    """Exponent by which planning (motion, schedule, checks) grows with the number of arms, from two on."""
    arms = [count for count in cells if count > 1]
    if len(arms) < 2:
        return None
    plan_s = [sum(cells[count][key] for key in ("motion_s", "schedule_s", "checks_s")) for count in arms]
    return round(float(np.polyfit(np.log(arms), np.log(plan_s), 1)[0]), 2)


def read(path: Path) -> dict[str, list[Row]]:
    """Task -> its rows."""
    rows: dict[str, list[Row]] = defaultdict(list)
    for line in path.read_text("utf-8").splitlines() if path.exists() else ():
        row = json.loads(line)
        rows[row["task"]].append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--arms", default="1,2,3,4,5,6,7,8")
    parser.add_argument("--things", default="1", help="for each arm, or through the hands of all")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("outputs/arms"))
    args = parser.parse_args()
    counts = [[int(number) for number in text.split(",")] for text in (args.arms, args.things)]
    for family in args.families.split(","):
        if family not in FAMILIES:
            parser.error(str(unknown_choice("family", family, FAMILIES)))
    args.out.mkdir(parents=True, exist_ok=True)
    path, results = args.out / "rows.jsonl", {}
    for family in args.families.split(","):
        for things in counts[1]:
            cells: dict[int, Row] = {}
            for arms in counts[0]:
                name = f"{family}_{arms}x{things}"
                try:
                    named_task(name)
                except ArgumentError as error:  # such as a tower that would be too high
                    print(f"{name:12s} {error}")
                    continue
                done_seeds = {row["seed"] for row in read(path)[name]}
                if missing_seeds := [seed for seed in range(args.seeds) if seed not in done_seeds]:
                    with ProcessPoolExecutor(1, get_context("spawn")) as process:
                        process.submit(cell, name, missing_seeds, str(path)).result()
                rows = [row for row in read(path)[name] if row["seed"] < args.seeds]
                cells[arms] = results[name] = summary(rows)
                print(
                    f"{name:12s} " + "  ".join(f"{key} {value}" for key, value in results[name].items()),
                    flush=True,
                )
            if cells:
                results[f"{family} x {things}: exponent"] = exponent(cells)
                print(f"{family} x {things}: planning grows with arms ** {exponent(cells)}")
    print(json.dumps(results))


if __name__ == "__main__":
    main()
