"""Motions between postures in VAMP-MR's scenes of Pandas: two with rods, four, four with rods over bins.

    python benchmarks/vamp_mr.py [--scenes panda_four] [--pairs 20] [--out FOLDER]

For every ordered pair of the named postures of a scene (`vamp_mr.yaml`), the suite's planner plans each arm,
schedules them and checks the result; `assume` is a verb added here. Postures that do not keep the planner's
margins are left out, as VAMP-MR leaves out those in collision. One row per pair in FOLDER/vamp_mr.jsonl; a
further run continues this file. The last line is JSON: for each scene the number of pairs with a plan, CPU
seconds (median and worst), the makespan, also against that of the slowest arm alone, and the reasons of
failures.
"""

import argparse
import json
import time
from collections import Counter
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.datagen import Motion, Planned, Planner, Request, Settings, State, add_primitive
from rf_exp.datagen.brain import Question, ScriptedSpec
from rf_exp.errors import unknown_choice
from rf_exp.findings import agent_name
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, measured_pair, nearest
from rf_exp.library.reading import GREY, ReadRobot, ReadTask
from rf_exp.library.workcell import FixedBrain
from rf_exp.statements import Proposal, Verb, add_verb, keep_clear
from rf_exp.tasks.assets import Asset, Part
from rf_exp.transforms import from_axes, planar, transform
from rf_exp.types import CONTROL_DT_S, FINGERS, ConstraintSet, JointLimits, Scene, Subgoal

# Velocity of VAMP-MR's benchmark, which does not limit accelerations; Franka's lowest limit of acceleration.
LIMITS = JointLimits(velocity_rad_s=1.0, acceleration_rad_s2=7.5)
OPEN_M, HELD_M = 0.035, 0.015  # of each finger from the middle
# tcp_from_rod. VAMP-MR defines it in a gripper frame that we lack; this choice leaves the most postures free.
ROD = from_axes((0, 0, 0), z=(1, 1, 0), y=(-1, 1, 0))
Row = dict[str, Any]
Postures = NDArray[np.float64]  # (N, 7) rad

_goals: dict[int, NDArray[np.float64]] = {}  # agent -> goal (7,) rad of the current pair


def assume(request: Request, state: State) -> Motion:
    """Primitive: one motion to the goal posture of an agent."""
    points = request.reach.free_motion(request.agent, _goals[request.agent], state, request.subgoal.text)
    moving, state = request.segment("assume", points, state)
    return (moving,), state


add_verb(Verb("assume", (), words=("assume assumes assumed assumed assuming",)))
add_primitive("assume", assume)


def cell(name: str, spec: Any) -> ReadTask:
    """The task of a scene: arms, rods as objects that they hold, and the sides of bins as static objects."""
    robots, assets = [], dict[str, Asset]()
    for x_m, y_m, yaw_rad in spec.bases:
        base, yaw_deg = planar(x_m, y_m, yaw_rad), float(np.degrees(yaw_rad))
        robots.append(ReadRobot(x_m, y_m, yaw_deg, pose=base, on_hand=None))
    for k in range(len(robots)) if "rod" in spec else ():
        rod = Part.cylinder(spec.rod.radius_m, spec.rod.length_m, transform(), GREY)
        assets[f"rod{k + 1}"] = Asset(f"rod{k + 1}", (rod,), mass_kg=0.1)
    for middle in spec.bins.middles if "bins" in spec else ():
        (low_m, high_m), half_m, thick_m = spec.bins.z_m, spec.bins.side_m / 2, spec.bins.thick_m / 2
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            position_m = (middle[0] + x * half_m, middle[1] + y * half_m, (low_m + high_m) / 2)
            extents_m = (thick_m if x else half_m, thick_m if y else half_m, (high_m - low_m) / 2)
            side = Part.box(extents_m, transform(position_m), GREY)
            side_name = f"side{len(assets) + 1}"
            assets[side_name] = Asset(side_name, (side,), static=True)
    return ReadTask.of(name, tuple(robots), assets, {}, {})


def scene_at(task: ReadTask, posture: Postures) -> Scene:
    """The scene with the arms in a posture, each with its rod if the task has rods."""
    poses = {name: transform() for name in task.objects}
    held = tuple(f"rod{agent}" if f"rod{agent}" in poses else None for agent in task.agents)
    for agent, rod in zip(task.agents, held, strict=True):
        if rod is not None:
            poses[rod] = task.arms[agent].tcp(posture[agent - 1]) @ ROD
    fingers = [[HELD_M if rod else OPEN_M] * FINGERS for rod in held]
    qpos = np.concatenate([posture, fingers], axis=1)
    return Scene(0, qpos, 0 * qpos, poses, dict.fromkeys(poses, 0.0), held)


def rejection_reason(task: ReadTask, posture: Postures) -> str:
    """The reason why no plan may begin or end in a posture; empty where one may."""
    scene = PlanningScene(task, scene_at(task, posture))
    for pair in combinations(task.agents, 2):
        closest = nearest(*measured_pair(scene, pair, lambda _: frozenset()))
        if closest.distance_m < AGENT_MARGIN_M:
            return (
                f"{closest.a} and {closest.b} of {' and '.join(map(agent_name, pair))}: "
                f"{closest.distance_m:.3f} m"
            )
    return plan_pair(task, posture, posture).get("reason", "")


def plan_pair(task: ReadTask, start: Postures, goal: Postures) -> Row:
    """Row of one pair: whether there is a plan, CPU seconds, and its makespan or the reason of failure."""
    _goals.update(zip(task.agents, goal, strict=True))
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec(), limits=LIMITS)
    scene, subgoals = scene_at(task, start), tuple(Subgoal(agent, "assume") for agent in task.agents)
    planner = Planner(settings, FixedBrain(Proposal(subgoals, (*keep_clear(task.agents),))))
    began = time.process_time()
    result = planner.plan(Question(task, scene, {}), scene, np.random.default_rng(0))
    row: Row = {"plan": isinstance(result, Planned), "cpu_s": round(time.process_time() - began, 3)}
    if isinstance(result, Planned):
        return {**row, "steps": len(result.schedule), "alone": max(map(len, result.trajectories))}
    assert result is not None  # there are subgoals
    return {**row, "reason": result.kind}


def summary(rows: list[Row]) -> Row:
    """Summary of the pairs of a scene."""
    planned_rows = [row for row in rows if row["plan"]]
    cpu_s = [row["cpu_s"] for row in rows]
    result = {"pairs": len(rows), "planned": len(planned_rows), "cpu_s": round(float(np.median(cpu_s)), 2)}
    result |= {"worst_cpu_s": max(cpu_s)}
    if planned_rows:
        steps, alone = (sum(row[key] for row in planned_rows) for key in ("steps", "alone"))
        result |= {"makespan_s": round(steps / len(planned_rows) * CONTROL_DT_S, 2)}
        result |= {"over_slowest_alone": round(steps / alone - 1, 3)}
    return {**result, "reasons": Counter(row["reason"] for row in rows if not row["plan"]).most_common()}


def main() -> None:
    scenes = OmegaConf.load(Path(__file__).with_suffix(".yaml"))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default=",".join(map(str, scenes)))
    parser.add_argument("--pairs", type=int, help="of each scene, the first; all unless given")
    parser.add_argument("--out", type=Path, default=Path("outputs/vamp_mr"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path, results = args.out / "vamp_mr.jsonl", {}
    rows = [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []
    for name in args.scenes.split(","):
        if name not in scenes:
            parser.error(str(unknown_choice("scene", name, scenes)))
        task = cell(name, scenes[name])
        postures = {
            str(posture_name): np.array(rad, dtype=float)
            for posture_name, rad in scenes[name].postures.items()
        }
        left_out = {
            posture_name: reason
            for posture_name, rad in postures.items()
            if (reason := rejection_reason(task, rad))
        }
        pairs = list(
            permutations([posture_name for posture_name in postures if posture_name not in left_out], 2)
        )[: args.pairs]
        done_pairs = {(row["from"], row["to"]) for row in rows if row["scene"] == name}
        for start, goal in pairs:
            if (start, goal) in done_pairs:
                continue
            row = {
                "scene": name,
                "from": start,
                "to": goal,
                **plan_pair(task, postures[start], postures[goal]),
            }
            rows.append(row)
            with path.open("a", encoding="utf-8") as file:
                print(json.dumps(row), file=file)
            print(row, flush=True)
        scene_rows = [row for row in rows if row["scene"] == name and (row["from"], row["to"]) in pairs]
        results[name] = {**summary(scene_rows), "left_out": left_out}
    print(json.dumps(results))


if __name__ == "__main__":
    main()
