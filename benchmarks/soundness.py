"""Missed collisions and false alarms of occupancy models, against exact convex hulls.

    python benchmarks/soundness.py [--states 10000] [--near 2000] [--seed 0] [--workers 1]

Random states of the teams of three tasks (two, three and four arms over the table): arms that lean over the
shared area, fingers at random openings, half of the grippers with a load at its annotated grasp point. No arm
collides with itself or with the table. States near contact are made from random ones that collide: the whole
team is moved back towards rest until its gap has a random value within 15 mm of contact, on either side, half
of them within 2 mm. Ground truth: coal on the convex hulls of all pairs of links and loads of two arms; no
pair is skipped. The first model is the paper's text taken literally. Two are the project's own, called
unchanged: the check of a plan before execution (`AvoidAgentsCheck.planned`, with its 10 mm margin) and the
monitor of the measured state (`contact_evidence`).

Each state is one sample, whatever its number of arms. The last line is JSON: for each model the share of
missed collisions and of flagged free states with Wilson's 95 % intervals, and CPU ms per state, including
the construction of bodies.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path

import coal
import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf
from scipy.optimize import brentq

from rf_exp.ablation import wilson
from rf_exp.constraints import AvoidAgentsCheck, Paths, Plan, contact_evidence
from rf_exp.geometry import (
    AGENT_MARGIN_M,
    VOXEL_M,
    PlanningScene,
    Separation,
    Swept,
    nearest,
    self_collisions,
    shared,
    voxels,
)
from rf_exp.processes import in_order
from rf_exp.robots import DEFAULT
from rf_exp.tasks import ObjectSpec, Task, load_task
from rf_exp.transforms import Matrix, inverse
from rf_exp.types import ConstraintSet, Scene, Schedule, Segment, Subgoal, Trajectory

CONF = Path(__file__).resolve().parents[1] / "conf" / "task"
TEAMS = ("lift_barrier", "three_robots_stack_cube", "take_photo")  # of two, three and four arms
LOADS = (
    ("steak", "center"), ("shoe", "center"), ("camera", "left"), ("camera", "right"),
    ("cube", "center"), ("hammer", "handle"), ("lid", "knob"),
)  # fmt: skip
LEAN = np.array([0.0, 0.8, 0.0, -1.2, 0.0, 2.0, 0.8])  # rad, reaching over the shared area
SPREAD_RAD = 0.5
NEAR_M = 0.015
XTOL = 1e-5  # tolerance, as a fraction of the way back to rest
BONE_STEP_M = 0.01
FINE_M = 0.025
CHUNK = 100  # states of one random stream, so that results do not depend on the number of workers


@dataclass(frozen=True, eq=False)
class State:
    """State of a team; the objects of its task are the loads of its arms."""

    task: Task
    qpos: NDArray[np.float64]  # (N, 9) rad, metres
    loads: tuple[str | None, ...]  # (N,)
    grips: tuple[Matrix | None, ...]  # (N,) tcp_from_object

    def bodies(self) -> list[Swept]:
        planning_scene = PlanningScene(self.task, self.scene())
        return [self._arm(planning_scene, agent) for agent in self.task.agents]

    def scene(self) -> Scene:
        arms = PlanningScene(self.task, _empty(self.qpos)).arms
        poses = {
            load: arm.tcp(qpos) @ grip
            for arm, qpos, load, grip in zip(arms, self.qpos, self.loads, self.grips, strict=True)
            if load is not None and grip is not None
        }
        return replace(_empty(self.qpos), poses=poses, held=self.loads)

    def plan(self) -> Plan:
        """The plan for the checker: all arms hold still for one control step."""
        arms = zip(self.task.agents, self.qpos, self.loads, self.grips, strict=True)
        trajectories = tuple(_still(*arm) for arm in arms)
        schedule = Schedule(np.arange(2)[:, None].repeat(len(trajectories), axis=1), 1)
        return Plan(Paths(self.task, ConstraintSet("full"), self.scene(), trajectories), schedule)

    def pairs(self) -> tuple[tuple[int, int], ...]:
        return tuple(combinations(self.task.agents, 2))

    def clear_of_itself_and_table(self) -> bool:
        bodies = self.bodies()
        return not any(
            self_collisions(body, DEFAULT.self_pairs).any() or PlanningScene.below_table(body).any()
            for body in bodies
        )

    def _arm(self, planning_scene: PlanningScene, agent: int) -> Swept:
        load, grip = self.loads[agent - 1], self.grips[agent - 1]
        return planning_scene.arm(
            agent, self.qpos[agent - 1], attached=load, tcp_from_object=grip, touches=()
        )


def _empty(qpos: NDArray[np.float64]) -> Scene:
    return Scene(0, qpos, 0 * qpos, {}, {}, (None,) * len(qpos))


def _still(agent: int, qpos: NDArray[np.float64], load: str | None, grip: Matrix | None) -> Trajectory:
    joints, command = qpos[:7], 2 * qpos[7] / DEFAULT.hand.open_m - 1
    subgoal = Subgoal(agent, "hold", load)
    segment = Segment(agent, subgoal, "move", joints[None], np.array([command]), load, grip)
    return Trajectory(agent, joints, command, (segment,))


def team(name: str) -> Task:
    node = OmegaConf.to_container(OmegaConf.load(CONF / f"{name}.yaml"))
    assert isinstance(node, dict)
    return replace(load_task(name, node[name]), objects={})


def draw(task: Task, rng: np.random.Generator) -> State:
    """A random team leaning over the table; each arm alone is free of self-collision and of the table."""
    low, high = DEFAULT.limits_rad
    objects: dict[str, ObjectSpec] = {}
    arms = []
    for agent in task.agents:
        load, grip, opening_m = None, None, rng.uniform(0, DEFAULT.hand.open_m)
        if rng.random() < 0.5:
            asset, name = LOADS[rng.integers(len(LOADS))]
            load = f"{asset} of {agent}"
            objects[load] = ObjectSpec(asset)
            point = replace(task, objects=objects).asset(load).points[name]
            grip, opening_m = inverse(point.object_from_tcp), point.width_m / 2
        single = replace(
            task, robots=(task.robots[agent - 1],), cameras=_cameras(task), objects=dict(objects)
        )
        while True:
            joints = np.clip(LEAN + rng.normal(0, SPREAD_RAD, 7), low, high)
            qpos = np.array([*joints, opening_m, opening_m])
            if State(single, qpos[None], (load,), (grip,)).clear_of_itself_and_table():
                break
        arms.append((qpos, load, grip))
    qpos, loads, grips = zip(*arms, strict=True)
    return State(replace(task, objects=objects), np.array(qpos), loads, grips)


def _cameras(task: Task) -> dict:
    return {name: task.cameras[name] for name in ("global", "agent1")}


def touches(state: State) -> bool:
    """Whether a fresh monitor finds arms of the measured state touching."""
    separation = Separation(state.task)
    return contact_evidence(separation, state.scene(), state.pairs(), lambda agent: frozenset()) is not None


def near_contact(state: State, target_m: float) -> State | None:
    """The team moved back towards rest until its gap is `target_m`; None where there is no such state."""
    rest = state.qpos.copy()
    rest[:, :7] = DEFAULT.rest_rad

    def drawn_back(fraction: float) -> State:
        return replace(state, qpos=state.qpos + fraction * (rest - state.qpos))

    def excess_m(fraction: float) -> float:
        return gap_m(drawn_back(fraction)) - target_m

    collided = touches(state)
    if not collided or excess_m(0.0) > 0 or excess_m(1.0) < 0:
        return None
    candidate = drawn_back(float(brentq(excess_m, 0.0, 1.0, xtol=XTOL, full_output=False)))  # pyright: ignore
    return candidate if abs(gap_m(candidate)) < NEAR_M and candidate.clear_of_itself_and_table() else None


def gap_m(state: State) -> float:
    """The smallest distance of two arms with their loads; negative where they overlap."""
    nearest_pairs = [nearest(a, b) for a, b in combinations(state.bodies(), 2)]
    return min(nearest_pair.distance_m for nearest_pair in nearest_pairs if nearest_pair is not None)


# truth


def hull_pairs(state: State) -> Iterator[tuple]:
    """Shapes and poses of all pairs of hulls of two arms."""
    for a, b in combinations(state.bodies(), 2):
        for i, x in enumerate(a.pieces):
            for j, y in enumerate(b.pieces):
                yield x.shape, a.coal_transform(0, i), y.shape, b.coal_transform(0, j)


def collides(state: State) -> bool:
    """Whether any two hulls of two arms intersect; no pair is skipped."""
    request = coal.CollisionRequest()
    return any(coal.collide(*pair, request, coal.CollisionResult()) for pair in hull_pairs(state))


def distance_m(state: State) -> float:
    """As `gap_m`, with no pair of hulls skipped."""
    request = coal.DistanceRequest()
    return min(coal.distance(*pair, request, coal.DistanceResult()) for pair in hull_pairs(state))


# models


def joints(body: Swept) -> NDArray[np.float64]:
    """Link origins (L, 3), the joint points of the paper's text, and the origin of the load."""
    return body.poses[0, :, :3, 3]


def bones(body: Swept) -> NDArray[np.float64]:
    """Points (K, 3) along the straight lines between consecutive joints."""
    lines = []
    for start, end in pairwise(joints(body)):
        count = 2 + int(np.linalg.norm(end - start) / BONE_STEP_M)
        lines.append(start + np.linspace(0, 1, count)[:, None] * (end - start))
    return np.concatenate(lines)


def of_points(points: Callable[[Swept], NDArray[np.float64]]) -> Callable[[State], bool]:
    """Model that fills only the voxels of some points."""

    def alarm(state: State) -> bool:
        filled = [np.floor(points(body) / VOXEL_M).astype(np.int64) for body in state.bodies()]
        return any(len(shared(a, b)) for a, b in combinations(filled, 2))

    return alarm


def of_volume(voxel_m: float) -> Callable[[State], bool]:
    """Model that fills every voxel that a body enters."""

    def alarm(state: State) -> bool:
        filled = [voxels(body, voxel_m=voxel_m) for body in state.bodies()]
        return any(len(shared(a, b)) for a, b in combinations(filled, 2))

    return alarm


def two_phase(state: State) -> bool:
    """Model with a broad phase by voxels, and exact distances of the arms that share one."""
    filled_bodies = [(body, voxels(body)) for body in state.bodies()]
    for (a, filled_a), (b, filled_b) in combinations(filled_bodies, 2):
        if len(shared(filled_a, filled_b)):
            nearest_pair = nearest(a, b)
            if nearest_pair is not None and nearest_pair.distance_m <= 0:
                return True
    return False


def planned_too_close(state: State) -> bool:
    """Model that is the check of a plan before execution."""
    return not AvoidAgentsCheck(state.task.agents).planned(state.plan()).ok


MODELS: dict[str, Callable[[State], bool]] = {
    "joint points, 5 cm (the paper's text)": of_points(joints),
    "bone segments, 5 cm": of_points(bones),
    "volume, 5 cm": of_volume(VOXEL_M),
    "volume, 2.5 cm": of_volume(FINE_M),
    "volume, 5 cm, then exact": two_phase,
    "default, measured (touching)": touches,
    "default, planned (AvoidAgents, 10 mm)": planned_too_close,
    "exact, all pairs of hulls": collides,
}


# the run


@dataclass(frozen=True)
class Sample:
    """One state with the verdicts of all models."""

    arms: int
    loads: int
    near: bool
    collides: bool
    distance_m: float
    alarms: tuple[bool, ...]  # in the order of MODELS
    spent_s: tuple[float, ...]


def states(kind: str, count: int, seed: int, chunk: int) -> Iterator[State]:
    rng = np.random.default_rng([seed, ("random", "near").index(kind), chunk])
    teams = [team(name) for name in TEAMS]
    count_made = 0
    while count_made < count:
        state: State | None = draw(teams[count_made % len(teams)], rng)
        if kind == "near":
            state = near_contact(state, NEAR_M * rng.uniform(-1, 1) ** 3)
        if state is not None:
            count_made += 1
            yield state


def measure(kind: str, count: int, seed: int, chunk: int) -> list[Sample]:
    """Samples of one chunk of states."""
    samples = []
    for state in states(kind, count, seed, chunk):
        alarms, spent_s = [], []
        for model in MODELS.values():
            begin = time.process_time()
            alarms.append(bool(model(state)))
            spent_s.append(time.process_time() - begin)
        held = sum(load is not None for load in state.loads)
        truth = alarms[-1], distance_m(state)
        samples.append(Sample(len(state.qpos), held, kind == "near", *truth, tuple(alarms), tuple(spent_s)))
    return samples


def rate(hits: NDArray[np.bool_]) -> dict[str, float | int]:
    """Count, share and interval in percent of the True entries."""
    if not len(hits):
        return {"count": 0, "of": 0}
    estimate = wilson(int(hits.sum()), len(hits))
    shares = {"pct": estimate.value, "low_pct": estimate.low, "high_pct": estimate.high}
    return {"count": int(hits.sum()), "of": len(hits), **{k: round(100 * v, 2) for k, v in shares.items()}}


def percent(figure: dict[str, float | int]) -> str:
    if not figure["of"]:
        return "none"
    return f"{figure['pct']:.2f} % [{figure['low_pct']:.2f}, {figure['high_pct']:.2f}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=int, default=10_000, help="random states")
    parser.add_argument("--near", type=int, default=2_000, help="states near contact")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()

    measure("random", len(TEAMS), args.seed + 1, 0)  # warm up: shapes are cached
    counts_by_kind = {"random": args.states, "near": args.near}
    jobs = [
        partial(measure, kind, min(CHUNK, count - begin), args.seed, begin // CHUNK)
        for kind, count in counts_by_kind.items()
        for begin in range(0, count, CHUNK)
    ]
    samples = [sample for chunk in in_order(jobs, args.workers) for sample in chunk]
    near = np.array([sample.near for sample in samples])
    truth = np.array([sample.collides for sample in samples])
    far = np.array([sample.distance_m > AGENT_MARGIN_M for sample in samples])
    alarms = np.array([sample.alarms for sample in samples])
    spent_s = np.array([sample.spent_s for sample in samples])

    counts = {
        "random": int((~near).sum()),
        "random_colliding": int((truth & ~near).sum()),
        "random_free_within_margin": int((~truth & ~far & ~near).sum()),
        "near": int(near.sum()),
        "near_colliding": int((truth & near).sum()),
        "arms": {str(n): sum(s.arms == n for s in samples) for n in (2, 3, 4)},
        "with_loads": sum(s.loads > 0 for s in samples),
    }
    print(
        "{random} random states: {random_colliding} collide, {random_free_within_margin} are free but within "
        "the margin; {near} near contact: {near_colliding} collide; {with_loads} with loads\n".format(
            **counts
        )
    )
    result = {}
    print(
        "| model | collisions missed | missed near contact | false alarms, free | "
        f"free by over {AGENT_MARGIN_M * 1000:.0f} mm | ms |"
    )
    print("|---|---|---|---|---|---|")
    for column, name in enumerate(MODELS):
        alarm = alarms[:, column]
        figures = {
            "missed": rate(~alarm[truth & ~near]),
            "missed_near": rate(~alarm[truth & near]),
            "false": rate(alarm[~truth & ~near]),
            "false_far": rate(alarm[far & ~near]),
        }
        ms = round(1e3 * float(spent_s[:, column].mean()), 2)
        result[name] = {**figures, "ms": ms}
        cells = [percent(figures[key]) for key in ("missed", "missed_near", "false", "false_far")]
        print(f"| {name} | {' | '.join(cells)} | {ms:.2f} |")
    print(json.dumps({"benchmark": "soundness", **counts, "models": result}))


if __name__ == "__main__":
    main()
