"""Task allocation: assignments against enumeration and simple rules, and their effect on schedules.

    python benchmarks/allocation.py [--seeds 20] [--scenes 5] [--parts loads,reach,pool]

*loads*: random times of 5 to 40 jobs of 2 to 8 agents, a third out of reach: the largest load against every
assignment where there are at most 20 000, against the proven bound, and against two rules: the longest job
first, to the agent that then finishes soonest (greedy), and each job to the agent that takes least time
(soonest). *reach*: 8 arms in a circle and 40 poses to reach, the setting of RoboBallet (2025), in a cell of
our own. *pool*: scenes of `pool_3x3`; each of the 27 assignments is planned, scheduled and checked, which
ranks the makespan of the chosen one among all; nearest: each object to the nearest base. Times are CPU
seconds. The last line is JSON.
"""

import argparse
import json
import time
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import assign
from rf_exp.coordination.assignment import agent_loads_s, greedy
from rf_exp.datagen import Planned, Planner, Settings, State, allocate_jobs
from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.reach import LookAhead, Reach
from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task, default_of, named_task
from rf_exp.transforms import from_axes
from rf_exp.types import ConstraintSet, JointLimits

SIZES = ((5, 2), (5, 3), (6, 4), (8, 3), (8, 8), (16, 8), (40, 8))  # jobs, agents
MAX_ENUMERATED = 20_000  # assignments up to which all are enumerated
REACHED = 40  # poses
Row = dict[str, Any]


def compare(times_s: NDArray[np.float64]) -> Row:
    """Row of one instance with times (J, N) in s."""
    jobs, agents = times_s.shape
    no_load = np.zeros(agents)
    began = time.process_time()
    assignment = assign(times_s)
    cpu_s = time.process_time() - began
    assert assignment is not None
    row = {
        "load": assignment.largest_s,
        "bound": assignment.bound_s,
        "optimal": assignment.optimal,
        "cpu_s": cpu_s,
    }
    row["greedy"] = float(agent_loads_s(times_s, greedy(times_s, no_load), no_load).max())
    row["soonest"] = float(agent_loads_s(times_s, times_s.argmin(axis=1), no_load).max())
    if agents**jobs <= MAX_ENUMERATED:
        row["best"] = min(
            float(agent_loads_s(times_s, np.array(chosen), no_load).max())
            for chosen in product(range(agents), repeat=jobs)
        )
    return row


def summary(rows: list[Row]) -> Row:
    """Mean ratios over the instances of a size."""

    def mean_ratio(key: str, denominator: str) -> float:
        return round(float(np.mean([row[key] / row[denominator] for row in rows])), 4)

    result = {
        "instances": len(rows),
        "proven_optimal": sum(row["optimal"] for row in rows),
        "load_over_bound": mean_ratio("load", "bound"),
        "greedy_over_load": mean_ratio("greedy", "load"),
        "soonest_over_load": mean_ratio("soonest", "load"),
        "cpu_s": round(float(np.mean([row["cpu_s"] for row in rows])), 3),
    }
    if "best" in rows[0]:
        result["load_over_best"] = round(max(row["load"] / row["best"] for row in rows), 6)
    return result


def random_times(seed: int, jobs: int, agents: int) -> NDArray[np.float64]:
    """Random times (J, N) in s, infinite out of reach; each job is in reach of at least one agent."""
    rng = np.random.default_rng([seed, jobs, agents])
    times_s = rng.uniform(2.0, 9.0, (jobs, agents))
    times_s[rng.random((jobs, agents)) < 1 / 3] = np.inf
    times_s[np.arange(jobs), rng.integers(agents, size=jobs)] = rng.uniform(2.0, 9.0, jobs)
    return times_s


def reach_times(seed: int) -> NDArray[np.float64]:
    """Times (40, 8) in s, there and back, of random poses over a table surrounded by eight arms."""
    task = named_task("ring_8x1")
    assert task is not None
    reach = Reach(
        task.arms,
        JointLimits(**default_of("limits")),
        lambda *_, **__: None,
        Search(np.random.default_rng(0)),
    )
    rng = np.random.default_rng(seed)
    rest = {agent: np.array(task.robots[agent - 1].rest_rad) for agent in task.agents}
    state = State(rest, dict.fromkeys(rest, 1.0), {}, {})
    rows = []
    while len(rows) < REACHED:
        radius_m, turn_rad, height_m = rng.uniform((0.0, 0.0, 0.05), (0.6, 2 * np.pi, 0.5))
        tilt = rng.normal(0.0, 0.4, 2)
        at_m = (radius_m * np.cos(turn_rad), radius_m * np.sin(turn_rad), height_m)
        pose = from_axes(at_m, z=(*tilt, -1.0), y=(0, 1, 0))
        ahead = LookAhead(lambda _: lambda goal, points: 0.0)
        row = [reach.estimated_s(agent, [[pose]], 0.1, state, ahead) for agent in task.agents]
        if np.isfinite(row).any():
            rows.append(2 * np.array(row))
    return np.stack(rows)


def makespan(task: Task, proposal: Proposal, seed: int) -> int | None:
    """Makespan of the checked plan in control steps; None where there is no plan."""

    class FixedBrain:
        name = "said"

        def answer(self, question: Question) -> str:
            return to_json(proposal)

    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec()).in_scene(seed)
    scene = task.in_scene(seed).start(seed).scene
    result = Planner(settings, FixedBrain()).plan(
        Question(settings.task, scene, {}), scene, np.random.default_rng(seed)
    )
    return len(result.schedule) if isinstance(result, Planned) else None


def scene(seed: int) -> Row:
    """Makespans of a scene with three objects and three arms: chosen, best and nearest assignment."""
    task = named_task("pool_3x3")
    assert task is not None
    start = task.in_scene(seed).start(seed).scene
    plan = task.module.plan(start, task)
    chosen = allocate_jobs(plan, task, start, JointLimits(**default_of("limits")))
    objects = list(dict.fromkeys(subgoal.object for subgoal in plan.subgoals))
    base = {agent: arm.world_from_base[:2, 3] for agent, arm in task.arms.items()}
    nearest_agents = tuple(
        min(task.agents, key=lambda agent: np.linalg.norm(start.poses[name or ""][:2, 3] - base[agent]))
        for name in objects
    )
    agent_of = {subgoal.object: subgoal.agent for subgoal in chosen.subgoals}
    steps: dict[tuple[int, ...], int | None] = {}
    for agents in product(task.agents, repeat=len(objects)):
        agent_by_object = dict(zip(objects, agents, strict=True))
        subgoals = tuple(replace(subgoal, agent=agent_by_object[subgoal.object]) for subgoal in plan.subgoals)
        proposal = Proposal(subgoals, (*grasping(subgoals), *keep_clear(task.agents)))
        steps[agents] = makespan(task, proposal, seed)
    possible = sorted(count for count in steps.values() if count is not None)
    chosen_steps, nearest = steps[tuple(agent_of[name] for name in objects)], steps[nearest_agents]
    return {"chosen": chosen_steps, "best": possible[0], "nearest": nearest, "possible": len(possible)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--parts", default="loads,reach,pool")
    args = parser.parse_args()
    results: dict[str, Any] = {}
    if "loads" in args.parts:
        for jobs, agents in SIZES:
            rows = [compare(random_times(seed, jobs, agents)) for seed in range(args.seeds)]
            results[f"{jobs} jobs, {agents} agents"] = summary(rows)
    if "reach" in args.parts:
        rows = []
        for seed in range(args.scenes):
            began = time.process_time()
            times_s = reach_times(seed)
            rows.append({"kinematics_s": time.process_time() - began, **compare(times_s)})
        kinematics_s = round(float(np.mean([row["kinematics_s"] for row in rows])), 2)
        results["reach"] = {**summary(rows), "kinematics_s": kinematics_s}
    if "pool" in args.parts:
        results["pool"] = [scene(seed) for seed in range(args.scenes)]
    for name, value in results.items():
        print(name, value)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
