"""Agreement of the monitor with signal temporal logic, evaluated by rtamt, on executed episodes.

    python benchmarks/stl.py [--episodes 20] [--tasks all] [--log FILE]

Every other episode is made with all constraints on, the others with only the logical ones, so that the other
constraints are violated at times. Each executed plan is judged by all constraints of its proposal, whether on
or not, and by random limits, orders and zones. A verdict is one check on one executed plan, by the monitor
and by the robustness of its formulas. Violations of a schedule beyond the executed part are undecided. With
--log every episode is a line of that file, and episodes that it has are not made again. The last line is
JSON.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from rf_exp.constraints import Check, RoboChecker, compile_statement
from rf_exp.constraints.stl import evaluate_check, monitor_verdict
from rf_exp.datagen import EpisodeGenerator, Settings, Trace
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.sim import shared_simulator
from rf_exp.statements import (
    Before,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    PlaceAt,
    Proposal,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
)
from rf_exp.tasks import Task, load_task
from rf_exp.texts import markdown
from rf_exp.types import NO_PICTURES, ConstraintSet

CONF = Path(__file__).resolve().parents[1] / "conf" / "task"
FULL, LOGICAL, WITHOUT_PICTURES = (
    ConstraintSet("full"),
    ConstraintSet("logical", spatial=False, temporal=False),
    NO_PICTURES,
)


def random_statements(
    task: Task, proposal: Proposal, length_s: float, rng: np.random.Generator
) -> Iterator[Statement]:
    """Random constraints that an episode may violate or satisfy."""
    agent, other = (int(value) for value in rng.choice(task.agents, 2, replace=len(task.agents) < 2))
    object_name = str(rng.choice(sorted(task.objects)))
    goals = [goal for goal in proposal.subgoals if goal.object]
    yield KeepHeight(agent, float(rng.uniform(0.1, 0.6)), rng.choice(["below", "above"]))
    yield SpeedLimit(agent, float(rng.uniform(0.05, 0.4)))
    chosen_goals = [goals[int(at)] for at in rng.permutation(len(goals))[:3]]
    for goal in chosen_goals:
        yield KeepLevel(goal.object or "", float(rng.uniform(0, 6)), goal.agent)
        yield Direction(goal.agent, goal.object or "", rng.choice(["vertical", "horizontal", "level"]))
        yield Direction(goal.agent, goal.object or "", rng.choice(["vertical", "level"]), goal.verb)
        if goal.target in task.objects and goal.target_point:
            yield PlaceAt(goal.agent, goal.object or "", goal.target or "", goal.target_point)
    for step in (Step(agent), *(Step(goal.agent, goal.verb, goal.object) for goal in chosen_goals)):
        yield Deadline(step, float(rng.uniform(0, length_s)))
    low = rng.uniform((-0.5, -0.5, 0), (0.3, 0.3, 0.3))
    low_m, high_m = (tuple(np.round(value, 2).tolist()) for value in (low, low + 0.2))
    yield KeepOut(agent, low_m, high_m)
    yield KeepOut(agent, low_m, high_m, occupied_by=object_name)
    if agent == other:
        return
    yield KeepOut(agent, low_m, high_m, occupied_by=other)
    yield KeepOut(agent, low_m, high_m, until=Step(other))
    pair = min(agent, other), max(agent, other)
    yield KeepApart(pair, float(rng.uniform(0.1, 0.8)), "grippers")
    yield KeepApart(pair, float(rng.uniform(0.02, 0.4)), "arms")
    yield SameHeight(pair)
    yield ShareSpace(pair)
    yield Together(pair, within_s=float(rng.uniform(0, 4)))
    goals_by_agent = [[goal for goal in goals if goal.agent == value] for value in (agent, other)]
    if all(goals_by_agent):
        chosen = (agent_goals[int(rng.permutation(len(agent_goals))[0])] for agent_goals in goals_by_agent)
        steps = (Step(goal.agent, goal.verb, goal.object) for goal in chosen)
        yield Before(*steps, wait_s=float(rng.choice([0.0, rng.uniform(0, 2)])))


def checks(task: Task, proposal: Proposal, length_s: float, rng: np.random.Generator) -> list[Check]:
    """The checks of the proposal, with implied ones, and of those random constraints that compile for it."""
    all_checks = list(RoboChecker(task, proposal, FULL).checks)
    for statement in random_statements(task, proposal, length_s, rng):
        try:
            all_checks.append(compile_statement(statement, task, proposal))
        except ArgumentError:
            continue
    return list(dict.fromkeys(all_checks))


def episode(task: Task, seed: int) -> dict[str, Any]:
    """Row of an episode: per kind of check the numbers of verdicts, of those with a number, of violations and
    of disagreements; and the two CPU times."""
    settings = Settings.configured(task, FULL if seed % 2 == 0 else LOGICAL, ScriptedSpec())
    trace, began, rng = Trace(), time.process_time(), np.random.default_rng([seed, 3])
    EpisodeGenerator(
        settings, shared_simulator(task, WITHOUT_PICTURES), settings.make_brain(seed), trace
    ).make(seed)
    episode_s, kinds, disagreements = time.process_time() - began, defaultdict(lambda: [0, 0, 0, 0]), []
    undecided = 0
    for planned, execution in trace.executions():
        for check in checks(task, planned.proposal, execution.clock_s[-1:].sum(), rng):
            counts, verdicts = kinds[type(check).__name__], evaluate_check(execution, check)
            monitor_holds, robust_holds = (
                monitor_verdict(execution, check),
                all(result.holds for result in verdicts),
            )
            if monitor_holds is None:
                undecided += 1
                continue
            counts[0] += 1
            counts[1] += any(result.applies for result in verdicts)
            counts[2] += not monitor_holds
            counts[3] += monitor_holds != robust_holds
            if monitor_holds != robust_holds:
                disagreements.append(
                    f"{planned.checker.code!r}: {check!r}: {[result.robustness for result in verdicts]}"
                )
    judged_s = time.process_time() - began - episode_s
    return {
        "task": task.name,
        "seed": seed,
        "row": settings.constraint_set.name,
        "kinds": kinds,
        "differ": disagreements,
        "undecided": undecided,
        "made_s": round(episode_s, 2),
        "judged_s": round(judged_s, 2),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown table of verdicts, violations and agreement, for each kind and task."""
    names = sorted({name for row in rows for name in row["kinds"]})
    lines = []
    for name in names:
        lines.append((name, *_cells([row["kinds"].get(name, (0, 0, 0, 0)) for row in rows])))
    lines += [("**task**", "", "", "", "")]
    for task in sorted({row["task"] for row in rows}):
        task_counts = [counts for row in rows if row["task"] == task for counts in row["kinds"].values()]
        lines.append((task, *_cells(task_counts)))
    return markdown.table(("kind", "verdicts", "with a number", "violated", "agree"), lines)


def _cells(counts: list[Any]) -> tuple[str, ...]:
    verdicts, numbers, violated, differ = np.sum(counts, axis=0).tolist()
    return str(verdicts), str(numbers), str(violated), f"{100 * (verdicts - differ) / max(1, verdicts):.2f} %"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=20, help="of each task")
    parser.add_argument("--tasks", default="all", help="with commas between")
    parser.add_argument("--log", type=Path, help="keep results here, and continue from it")
    args = parser.parse_args()
    names = (
        sorted(path.stem for path in CONF.glob("*.yaml")) if args.tasks == "all" else args.tasks.split(",")
    )
    rows = (
        [json.loads(line) for line in args.log.read_text().splitlines()]
        if args.log and args.log.exists()
        else []
    )
    known = {(row["task"], row["seed"]) for row in rows}
    for name in names:
        config = OmegaConf.to_object(OmegaConf.load(CONF / f"{name}.yaml"))
        assert isinstance(config, dict)
        task = load_task(name, config[name])
        for seed in range(args.episodes):
            if (name, seed) in known:
                continue
            rows.append(episode(task, seed))
            if args.log:
                with args.log.open("a") as log:
                    log.write(json.dumps(rows[-1]) + "\n")
    print(table(rows))
    for row in rows:
        for difference in row["differ"]:
            print(f"differs: {row['task']} {row['seed']}: {difference}")
    verdicts, numbers, violated, differ = np.sum(
        [counts for row in rows for counts in row["kinds"].values()], axis=0
    ).tolist()
    print(
        json.dumps(
            {
                "benchmark": "stl",
                "episodes": len(rows),
                "verdicts": verdicts,
                "with_a_number": numbers,
                "violated": violated,
                "differ": differ,
                "undecided": sum(row["undecided"] for row in rows),
                "made_s": round(float(np.mean([row["made_s"] for row in rows])), 2),
                "judged_s": round(float(np.mean([row["judged_s"] for row in rows])), 2),
            }
        )
    )


if __name__ == "__main__":
    main()
