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
from rf_exp.coordination.assignment import greedy, load_s
from rf_exp.datagen import Planned, Planner, Settings, State, allocated
from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.reach import LookAhead, Reach
from rf_exp.statements import Proposal, grasping, keep_clear
from rf_exp.tasks import Task, default_of, named_task
from rf_exp.transforms import from_axes
from rf_exp.types import ConstraintSet, JointLimits

SIZES = ((5, 2), (5, 3), (6, 4), (8, 3), (8, 8), (16, 8), (40, 8))  # jobs, agents
MOST = 20_000  # assignments up to which all are enumerated
REACHED = 40  # poses
Row = dict[str, Any]


def compared(takes_s: NDArray[np.float64]) -> Row:
    """Row of one instance with times (J, N) in s."""
    jobs, agents = takes_s.shape
    nothing = np.zeros(agents)
    began = time.process_time()
    found = assign(takes_s)
    spent_s = time.process_time() - began
    assert found is not None
    row = {"load": found.largest_s, "bound": found.bound_s, "optimal": found.optimal, "cpu_s": spent_s}
    row["greedy"] = float(load_s(takes_s, greedy(takes_s, nothing), nothing).max())
    row["soonest"] = float(load_s(takes_s, takes_s.argmin(axis=1), nothing).max())
    if agents**jobs <= MOST:
        row["best"] = min(
            float(load_s(takes_s, np.array(chosen), nothing).max())
            for chosen in product(range(agents), repeat=jobs)
        )
    return row


def summary(rows: list[Row]) -> Row:
    """Mean ratios over the instances of a size."""

    def over(key: str, by: str) -> float:
        return round(float(np.mean([row[key] / row[by] for row in rows])), 4)

    said = {
        "instances": len(rows),
        "proven_optimal": sum(row["optimal"] for row in rows),
        "load_over_bound": over("load", "bound"),
        "greedy_over_load": over("greedy", "load"),
        "soonest_over_load": over("soonest", "load"),
        "cpu_s": round(float(np.mean([row["cpu_s"] for row in rows])), 3),
    }
    if "best" in rows[0]:
        said["load_over_best"] = round(max(row["load"] / row["best"] for row in rows), 6)
    return said


def drawn(seed: int, jobs: int, agents: int) -> NDArray[np.float64]:
    """Random times (J, N) in s, infinite out of reach; each job is in reach of at least one agent."""
    rng = np.random.default_rng([seed, jobs, agents])
    takes_s = rng.uniform(2.0, 9.0, (jobs, agents))
    takes_s[rng.random((jobs, agents)) < 1 / 3] = np.inf
    takes_s[np.arange(jobs), rng.integers(agents, size=jobs)] = rng.uniform(2.0, 9.0, jobs)
    return takes_s


def reached(seed: int) -> NDArray[np.float64]:
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

    class Said:
        name = "said"

        def answer(self, question: Question) -> str:
            return to_json(proposal)

    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec()).of(seed)
    scene = task.of(seed).start(seed).scene
    made = Planner(settings, Said()).plan(
        Question(settings.task, scene, {}), scene, np.random.default_rng(seed)
    )
    return len(made.schedule) if isinstance(made, Planned) else None


def scene(seed: int) -> Row:
    """Makespans of a scene with three objects and three arms: chosen, best and nearest assignment."""
    task = named_task("pool_3x3")
    assert task is not None
    start = task.of(seed).start(seed).scene
    plan = task.module.plan(start, task)
    chosen = allocated(plan, task, start, JointLimits(**default_of("limits")))
    things = list(dict.fromkeys(each.object for each in plan.subgoals))
    base = {agent: arm.world_from_base[:2, 3] for agent, arm in task.arms.items()}
    near = tuple(
        min(task.agents, key=lambda agent: np.linalg.norm(start.poses[name or ""][:2, 3] - base[agent]))
        for name in things
    )
    who = {each.object: each.agent for each in chosen.subgoals}
    steps: dict[tuple[int, ...], int | None] = {}
    for agents in product(task.agents, repeat=len(things)):
        given = dict(zip(things, agents, strict=True))
        subgoals = tuple(replace(each, agent=given[each.object]) for each in plan.subgoals)
        whole = Proposal(subgoals, (*grasping(subgoals), *keep_clear(task.agents)))
        steps[agents] = makespan(task, whole, seed)
    possible = sorted(each for each in steps.values() if each is not None)
    ours, nearest = steps[tuple(who[name] for name in things)], steps[near]
    return {"chosen": ours, "best": possible[0], "nearest": nearest, "possible": len(possible)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--parts", default="loads,reach,pool")
    given = parser.parse_args()
    found: dict[str, Any] = {}
    if "loads" in given.parts:
        for jobs, agents in SIZES:
            rows = [compared(drawn(seed, jobs, agents)) for seed in range(given.seeds)]
            found[f"{jobs} jobs, {agents} agents"] = summary(rows)
    if "reach" in given.parts:
        rows = []
        for seed in range(given.scenes):
            began = time.process_time()
            takes_s = reached(seed)
            rows.append({"kinematics_s": time.process_time() - began, **compared(takes_s)})
        times_s = round(float(np.mean([row["kinematics_s"] for row in rows])), 2)
        found["reach"] = {**summary(rows), "kinematics_s": times_s}
    if "pool" in given.parts:
        found["pool"] = [scene(seed) for seed in range(given.scenes)]
    for name, value in found.items():
        print(name, value)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
