"""Up to three Pandas that visit waypoints in turn: a scene of the multi-robot planning benchmark.

    python benchmarks/waypoints.py [--arms 1,2,3] [--seeds 5] [--out FOLDER]

Each arm brings its fingertips to all waypoints in its reach, in order, at each waypoint after the previous
arm, and goes home (`waypoints.yaml`). The suite's planner plans, schedules and checks all of this at once;
`near` and `touch` are verbs added here, and a seed affects only the path search. One row per seed in
FOLDER/waypoints.jsonl. The last line is JSON: by the number of arms the number of seeds with a plan, CPU
seconds, the makespan against the proven bound for the paths and against the slowest arm alone, and the
reasons of failures.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from rf_exp.datagen import Motion, Planned, Planner, Request, Settings, State, Unreachable, add_primitive
from rf_exp.datagen.brain import Question, ScriptedSpec
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.planner import present_state
from rf_exp.datagen.motion.reach import LookAhead, Reach, drawn_back
from rf_exp.datagen.motion.state import Floats, Points
from rf_exp.datagen.motion.timing import parameterise
from rf_exp.findings import Cause, Finding
from rf_exp.library.reading import ReadRobot, ReadTask
from rf_exp.library.workcell import FixedBrain
from rf_exp.statements import Before, Proposal, Step, Verb, add_verb, keep_clear
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix, from_axes, planar, transform
from rf_exp.types import CONTROL_DT_S, FINGERS, ConstraintSet, JointLimits, Scene, Subgoal

LIMITS = JointLimits(velocity_rad_s=1.0, acceleration_rad_s2=7.5)  # as benchmarks/vamp_mr.py
OPEN_M = 0.035  # of each finger from the middle
NEAR_M = 0.15  # distance from a waypoint at which an arm may wait for its turn
# Tool angles: from straight down to upwards, from the direction base to waypoint, and about the tool's axis.
PITCH_RAD, YAW_RAD, ROLL_RAD = (
    np.deg2rad(angles_deg) for angles_deg in (range(-90, 61, 30), (-60, -30, 0, 30, 60), (0, 90))
)
Row = dict[str, Any]


def directions(base: Matrix, waypoint: Matrix) -> list[Matrix]:
    """Candidate TCP poses (4, 4) with the fingertips at a waypoint, whose orientation is free."""
    position_m, poses = waypoint[:3, 3], []
    ahead_rad = np.arctan2(*(position_m - base[:3, 3])[1::-1])
    for pitch, yaw, roll in product(PITCH_RAD, YAW_RAD + ahead_rad, ROLL_RAD):
        z = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        y = np.cos(roll) * across + np.sin(roll) * np.cross(z, across)
        poses.append(from_axes(position_m, z=z, y=y))
    return poses


def near(request: Request, state: State) -> Motion:
    """Primitive: motion to a pose `NEAR_M` before a waypoint from which a straight line leads to it."""
    reach, agent, name = request.reach, request.agent, request.subgoal.object or ""
    goals = np.stack(directions(reach.arms[agent].world_from_base, state.poses[name]))
    before = drawn_back(goals, NEAR_M)

    def after(poses: Floats) -> Callable[[int, Points], float]:
        def takes_s(goal: int, points: Points) -> float:
            line = reach.line(agent, points[-1], drawn_back(poses[goal], -NEAR_M))
            return np.inf if line is None else float(reach.duration_s(line[[0, -1]]))

        return takes_s

    subgoal_text, ahead = request.subgoal.text, LookAhead(after)
    points = reach.timed(agent, [list(before)], 0.0, state, frozenset(), subgoal_text, look_ahead=ahead)
    moving, state = request.segment("near", points, state)
    return (moving,), state


def touch(request: Request, state: State) -> Motion:
    """Primitive: straight line to the waypoint and back, as the next arm comes to the same place.

    Raises Unreachable where there is no straight line.
    """
    reach, agent = request.reach, request.agent
    line = reach.line(agent, state.qpos[agent], drawn_back(request.tcp(state), -NEAR_M))
    if line is None:
        raise Unreachable(Cause.REACH, Finding.OUT_OF_REACH, (agent,), subgoals=(request.subgoal.text,))
    touching, state = request.segment("touch", parameterise(line, reach.limits), state)
    back, state = request.segment("retreat", parameterise(line[::-1], reach.limits), state)
    return (touching, back), state


for named, primitive in (("near", near), ("touch", touch)):
    add_verb(Verb(named, ("object",), words=(f"{named} {named}s {named}ed {named}ed {named}ing",)))
    add_primitive(named, primitive)


def cell(spec: Any, arms: int) -> tuple[ReadTask, Scene]:
    """Task and scene of the first `arms` arms at home, and the waypoints as objects without shapes."""
    robots = []
    for x_m, y_m, yaw_deg in spec.bases[:arms]:
        pose = planar(x_m, y_m, np.deg2rad(yaw_deg))
        robots.append(ReadRobot(x_m, y_m, yaw_deg, rest_rad=tuple(spec.home_rad), pose=pose, on_hand=None))
    marks = {f"way{k + 1}": Asset(f"way{k + 1}", (), static=True) for k in range(len(spec.waypoints_m))}
    task = ReadTask.of("waypoints", tuple(robots), marks, {}, {})
    qpos = np.tile([*spec.home_rad, *[OPEN_M] * FINGERS], (arms, 1))
    poses = {name: transform(position) for name, position in zip(marks, spec.waypoints_m, strict=True)}
    return task, Scene(0, qpos, 0 * qpos, poses, dict.fromkeys(poses, 0.0), (None,) * arms)


def in_reach(task: ReadTask, scene: Scene) -> list[tuple[str, int]]:
    """(waypoint, agent) for each waypoint and each agent that can reach it, in the order of visits."""
    reach = Reach(task.arms, LIMITS, lambda *_, **__: None, Search(np.random.default_rng(0)))
    state, no_lookahead = present_state(task, scene), LookAhead(lambda _: lambda goal, points: 0.0)
    reachable = []
    for name, agent in product(task.objects, task.agents):
        goals = directions(task.arms[agent].world_from_base, scene.poses[name])
        if np.isfinite(reach.estimated_s(agent, [goals], NEAR_M, state, no_lookahead)):
            reachable.append((name, agent))
    return reachable


def visit_proposal(task: ReadTask, touched: list[tuple[str, int]]) -> Proposal:
    """The proposal: all visits in order, then home."""
    subgoals = tuple(
        Subgoal(agent, verb, name)
        for agent in task.agents
        for name, visitor in touched
        for verb in ("near", "touch")
        if visitor == agent
    )
    turns = [Step(agent, "touch", name) for name, agent in touched]
    order = tuple(Before(first, second) for first, second in pairwise(turns) if first.agent != second.agent)
    home = tuple(Subgoal(agent, "home") for agent in task.agents)
    return Proposal(subgoals + home, (*order, *keep_clear(task.agents)))


def plan_seed(task: ReadTask, scene: Scene, proposal: Proposal, seed: int) -> Row:
    """Row of one seed: whether there is a plan, CPU seconds, and its makespan or the reason of failure."""
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec(), limits=LIMITS)
    planner = Planner(settings, FixedBrain(proposal))
    began = time.process_time()
    result = planner.plan(Question(task, scene, {}), scene, np.random.default_rng(seed))
    row: Row = {"plan": isinstance(result, Planned), "cpu_s": round(time.process_time() - began, 3)}
    if isinstance(result, Planned):
        steps, bound = len(result.schedule), result.schedule.makespan_bound
        return {**row, "steps": steps, "bound": bound, "alone": max(map(len, result.trajectories))}
    assert result is not None  # there are subgoals
    return {**row, "reason": result.kind, "sentence": result.sentence}


def summary(rows: list[Row]) -> Row:
    """Summary of the seeds of a number of arms."""
    planned_rows = [row for row in rows if row["plan"]]
    result: Row = {"seeds": len(rows), "touches": rows[0]["touches"], "planned": len(planned_rows)}
    result |= {"cpu_s": round(float(np.mean([row["cpu_s"] for row in rows])), 2)}
    if planned_rows:
        steps, bound, alone = (sum(row[key] for row in planned_rows) for key in ("steps", "bound", "alone"))
        result |= {"makespan_s": round(steps / len(planned_rows) * CONTROL_DT_S, 2)}
        result |= {
            "over_bound": round(steps / bound - 1, 4),
            "over_slowest_alone": round(steps / alone - 1, 3),
        }
    return {**result, "reasons": Counter(row["reason"] for row in rows if not row["plan"]).most_common()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", default="1,2,3")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("outputs/waypoints"))
    args = parser.parse_args()
    spec: Any = OmegaConf.load(Path(__file__).with_suffix(".yaml"))
    args.out.mkdir(parents=True, exist_ok=True)
    results = {}
    with (args.out / "waypoints.jsonl").open("w", encoding="utf-8") as file:
        for arms in map(int, args.arms.split(",")):
            if not 1 <= arms <= len(spec.bases):
                parser.error(f"{arms} arms; the scene has bases for 1 to {len(spec.bases)}")
            task, scene = cell(spec, arms)
            touched, rows = in_reach(task, scene), list[Row]()
            proposal = visit_proposal(task, touched)
            for seed in range(args.seeds):
                row = {"arms": arms, "seed": seed, "touches": len(touched)}
                rows.append({**row, **plan_seed(task, scene, proposal, seed)})
                print(json.dumps(rows[-1]), file=file, flush=True)
                print(rows[-1], flush=True)
            results[arms] = summary(rows)
    print(json.dumps(results))


if __name__ == "__main__":
    main()
