"""Schedules against serial motion and against the proven bound, and their cost.

    python benchmarks/schedule.py [--cases 10] [--positions 200] [--seed 0]

Random cases of two and of four arms that work in a shared area: out, two places, home. The last line is
JSON: mean and median of makespan against serial motion and against the proven bound, of the share of
forbidden cells, and of the ms for diagrams and for the search, in wall and CPU time.
"""

import argparse
import json
import statistics
import time

import numpy as np

from rf_exp.coordination import schedule
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, closer_than
from rf_exp.tasks import CameraSpec, Randomisation, RobotSpec, Task
from rf_exp.types import GRIPPER_OPEN, Scene, Schedule, Segment, Subgoal, Trajectory

BASES = ((0.0, -0.75, 90.0), (0.0, 0.75, -90.0), (0.75, 0.0, 180.0), (-0.75, 0.0, 0.0))  # m, m, deg
KEYS = ("of_serial", "gap", "forbidden", "diagrams_ms", "search_ms", "diagrams_cpu_ms", "search_cpu_ms")
SHARED_M = 0.15  # half side of the shared area
HEIGHT_M = (0.12, 0.30)
HOME = (0.0, -0.7, 0.0, -2.5, 0.0, 1.8, np.pi / 4)  # rad, drawn back: four at rest leave the area free


def team(count: int) -> tuple[Task, Scene]:
    cameras = {"global": CameraSpec(), **{f"agent{k}": CameraSpec() for k in range(1, count + 1)}}
    robots, still = tuple(RobotSpec(*base) for base in BASES[:count]), Randomisation(0.0, 0.0, 0.0, 0.0)
    task = Task("team", "", "", "", robots, {}, cameras, {}, still)
    qpos = np.tile([*HOME, 0.04, 0.04], (count, 1))
    return task, Scene(0, qpos, 0 * qpos, {}, {}, (None,) * count)


def trajectory(
    agent: int, planning_scene: PlanningScene, positions: int, rng: np.random.Generator
) -> Trajectory:
    """Trajectory from rest over two random places in the shared area, with a stop at each, back to rest."""
    arm, rest = planning_scene.arms[agent - 1], np.array(HOME)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    waypoints = [rest]
    for _ in range(2):
        solved = None
        while solved is None:
            position = (*rng.uniform(-SHARED_M, SHARED_M, 2), rng.uniform(*HEIGHT_M))
            world_from_tcp = arm.world_from_base.copy()
            world_from_tcp[:3, 3] = position
            solved = arm.solve(world_from_tcp @ down, waypoints[-1])
        waypoints.append(solved)
    waypoints.append(rest)
    counts = np.diff(np.linspace(0, positions, len(waypoints)).astype(int))
    segments = []
    for k, count in enumerate(counts.tolist()):
        fraction = (1 - np.cos(np.pi * np.arange(1, count + 1) / count)) / 2
        path = waypoints[k] + fraction[:, None] * (waypoints[k + 1] - waypoints[k])
        segments.append(
            Segment(agent, Subgoal(agent, "carry", f"thing{k}"), "move", path, np.full(count, GRIPPER_OPEN))
        )
    return Trajectory(agent, rest, GRIPPER_OPEN, tuple(segments))


def case(count: int, positions: int, rng: np.random.Generator) -> dict[str, float]:
    """One random case; where no schedule exists, its explanation is part of the cost."""
    task, scene = team(count)
    planning_scene = PlanningScene(task, scene)
    trajectories = [trajectory(agent, planning_scene, positions, rng) for agent in task.agents]
    begin_ms = now_ms()
    swept = [planning_scene.along(motion) for motion in trajectories]
    diagrams = {
        (i, j): closer_than(swept[i - 1], swept[j - 1], AGENT_MARGIN_M)
        for i in task.agents
        for j in task.agents
        if i < j
    }
    diagrams_done_ms = now_ms()
    result = schedule(trajectories, diagrams)
    search_done_ms = now_ms()
    names = ("diagrams_ms", "diagrams_cpu_ms", "search_ms", "search_cpu_ms")
    cost = dict(
        zip(names, (*(diagrams_done_ms - begin_ms), *(search_done_ms - diagrams_done_ms)), strict=True)
    )
    if not isinstance(result, Schedule):
        return {"feasible": 0.0, **cost}
    serial = sum(map(len, trajectories))
    return {
        "feasible": 1.0,
        "of_serial": len(result) / serial,
        "gap": len(result) / result.makespan_bound - 1,
        "forbidden": float(np.mean([diagram.mean() for diagram in diagrams.values()])),
        **cost,
    }


def now_ms() -> np.ndarray:
    """Wall and CPU time (2,) in ms."""
    return 1e3 * np.array([time.perf_counter(), time.process_time()])


def summary(values: list[float]) -> dict[str, float]:
    """Mean and median; NaN without values."""
    values = values or [float("nan")]
    return {"mean": round(statistics.fmean(values), 4), "median": round(statistics.median(values), 4)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=10, help="random cases for each number of arms")
    parser.add_argument("--positions", type=int, default=200, help="control steps of each arm alone")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    rng = np.random.default_rng(args.seed)
    case(2, 20, rng)  # warm up: meshes and covers are cached
    result: dict[str, object] = {"benchmark": "schedule", "positions": args.positions}
    for count in (2, 4):
        runs = [case(count, args.positions, rng) for _ in range(args.cases)]
        figures = {key: summary([run[key] for run in runs if key in run]) for key in KEYS}
        total = summary([run["diagrams_ms"] + run["search_ms"] for run in runs])
        total_cpu = summary([run["diagrams_cpu_ms"] + run["search_cpu_ms"] for run in runs])
        worst_ms = max(run["diagrams_ms"] + run["search_ms"] for run in runs)
        solved = int(sum(run["feasible"] for run in runs))
        exact = sum(run.get("gap", 1.0) == 0 for run in runs)
        mean = {key: figure["mean"] for key, figure in figures.items()}
        print(
            f"{count} arms: {solved} of {len(runs)} cases can be scheduled, {exact} proven optimal; mean "
            f"makespan {mean['of_serial']:.0%} of serial, {mean['gap']:.2%} above the bound; diagrams "
            f"{mean['diagrams_ms']:.0f} ms, search {mean['search_ms']:.1f} ms, worst {worst_ms:.0f} ms; "
            f"of the processor {total_cpu['mean']:.0f} ms in all"
        )
        result[f"{count}_arms"] = {
            "cases": len(runs),
            "solved": solved,
            "optimal": exact,
            **figures,
            "total_ms": total,
            "total_cpu_ms": total_cpu,
            "worst_ms": round(worst_ms),
        }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
