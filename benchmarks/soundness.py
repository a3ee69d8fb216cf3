"""What models of occupancy miss and what they cry wolf at, against exact convex hulls.

    python benchmarks/soundness.py [--states 600] [--seed 0]

Random states of two to four arms and, of every pair that collides, one state just before and one just
after first contact. Truth: coal on the convex hulls of all pairs of links. The last line is JSON:
percent of collisions missed and of clear pairs alarmed, and us a pair, for each model.
"""

import argparse
import json
import time
from collections.abc import Callable
from itertools import pairwise

import coal
import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Bodies, occupancy
from rf_exp.constraints.clearance import Swept, closer_than, overlap
from rf_exp.constraints.world import AGENT_MARGIN_M
from rf_exp.tasks import CameraSpec, RobotSpec, Task
from rf_exp.tasks.base import REST_QPOS
from rf_exp.types import Scene

BASES = ((0.0, -0.75, 90.0), (0.0, 0.75, -90.0), (0.75, 0.0, 180.0), (-0.75, 0.0, 0.0))  # m, m, deg
LEAN = np.array([0.0, 0.8, 0.0, -1.2, 0.0, 2.0, 0.8])  # rad, reaching over the shared middle
SPREAD_RAD = 0.5
BONE_STEP_M = 0.01


def team() -> Task:
    cameras = {"global": CameraSpec(), **{f"agent{k}": CameraSpec() for k in range(1, len(BASES) + 1)}}
    return Task("team", "", "", "", tuple(RobotSpec(*base) for base in BASES), {}, cameras, {})


def collides(a: Swept, b: Swept) -> bool:
    """The truth: any two hulls intersect; nothing is skipped."""
    request = coal.CollisionRequest()
    for i, x in enumerate(a.pieces):
        for j, y in enumerate(b.pieces):
            if coal.collide(
                x.shape, a.placed(0, i), y.shape, b.placed(0, j), request, coal.CollisionResult()
            ):
                return True
    return False


def joints(body: Swept) -> NDArray[np.float64]:
    """(L, 3) link origins, the joint points of the paper's text."""
    return body.poses[0, :, :3, 3]


def bones(body: Swept) -> NDArray[np.float64]:
    """Points along the straight lines from joint to joint."""
    points = joints(body)
    lines = []
    for start, end in pairwise(points):
        count = 2 + int(np.linalg.norm(end - start) / BONE_STEP_M)
        lines.append(start + np.linspace(0, 1, count)[:, None] * (end - start))
    return np.concatenate(lines)


def of_points(points: Callable[[Swept], NDArray[np.float64]]) -> Callable[[Swept, Swept], bool]:
    """The model that fills only the voxels of some points."""

    def alarm(a: Swept, b: Swept) -> bool:
        first, second = (np.floor(points(body) / occupancy.VOXEL_M).astype(np.int64) for body in (a, b))
        return len(occupancy.shared(first, second)) > 0

    return alarm


MODELS: dict[str, Callable[[Swept, Swept], bool]] = {
    "joint points, 5 cm": of_points(joints),
    "bone segments, 5 cm": of_points(bones),
    "link volume, 5 cm": lambda a, b: len(occupancy.shared(occupancy.voxels(a), occupancy.voxels(b))) > 0,
    "monitor: spheres, then exact": lambda a, b: overlap(a, b) is not None,
    "planning: 1 cm margin": lambda a, b: bool(closer_than(a, b, AGENT_MARGIN_M, between=False)[0, 0]),
}


def sample(
    bodies: Bodies, count: int, rng: np.random.Generator
) -> tuple[list[tuple[Swept, Swept]], list[tuple[Swept, Swept]]]:
    """`count` random pairs of arms; and for each that collides, one pair either side of first contact."""
    pairs, near = [], []
    agents = bodies.task.agents
    for _ in range(count):
        i, j = rng.choice(agents, 2, replace=False).tolist()
        here, there = LEAN + rng.normal(0, SPREAD_RAD, (2, 7))
        a = bodies.arm(i, here)
        pairs.append((a, bodies.arm(j, there)))
        rest = np.array(REST_QPOS)
        if collides(*pairs[-1]) and not collides(a, bodies.arm(j, rest)):
            low, high = 0.0, 1.0
            for _ in range(10):
                middle = (low + high) / 2
                hit = collides(a, bodies.arm(j, there + middle * (rest - there)))
                low, high = (middle, high) if hit else (low, middle)
            near += [(a, bodies.arm(j, there + f * (rest - there))) for f in (low, high)]
    return pairs, near


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=int, default=600, help="random pairs of arms")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    task = team()
    start = task.start(arguments.seed)
    scene = Scene(0, start.qpos, 0 * start.qpos, {}, {}, (None,) * len(BASES))
    random, near = sample(Bodies(task, scene), arguments.states, np.random.default_rng(arguments.seed))
    pairs = [*random, *near]
    is_near = np.arange(len(pairs)) >= len(random)
    truth = np.array([collides(a, b) for a, b in pairs])
    alarms = {name: np.zeros(len(pairs), dtype=bool) for name in MODELS}
    spent_s = dict.fromkeys(MODELS, 0.0)
    for k, (a, b) in enumerate(pairs):
        for name, model in MODELS.items():
            begin = time.perf_counter()
            alarms[name][k] = model(a, b)
            spent_s[name] += time.perf_counter() - begin

    def percent(alarm: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
        return round(100 * float(alarm[among].mean()), 2) if among.any() else 0.0

    print(
        f"{len(random)} random pairs of arms, {truth[~is_near].mean():.1%} collide; "
        f"{len(near)} near first contact"
    )
    print(f"{'model':30}{'missed':>9}{'missed near':>13}{'false alarms':>14}{'us a pair':>11}")
    result = {}
    for name, alarm in alarms.items():
        result[name] = {
            "missed_pct": percent(~alarm, truth & ~is_near),
            "missed_near_pct": percent(~alarm, truth & is_near),
            "false_alarm_pct": percent(alarm, ~truth & ~is_near),
            "us": round(1e6 * spent_s[name] / len(pairs)),
        }
        missed, missed_near, false, cost_us = result[name].values()
        print(f"{name:30}{missed:8.1f}%{missed_near:12.1f}%{false:13.1f}%{cost_us:11d}")
    print(json.dumps({"benchmark": "soundness", "random": len(random), "near": len(near), "models": result}))


if __name__ == "__main__":
    main()
