"""Disturbed motion: demonstrations of recovery (DART, Laskey et al. 2017).

The arms execute their paths with smooth perturbations added, while the intended commands are the ones that
are learned: they show a policy what leads back from states off the path. Perturbations are added to path
positions, not to time steps, so that the disturbed motion is a trajectory like any other, run by the same
schedule and judged by the same checks. A disturbed arm keeps clear of objects, whose motion is monitored.

Perturbations are bounded: by `TALLEST` standard deviations, and by `ADDED` in velocity and acceleration of a
joint. Disturbed motion stays within the sum of these and the limits of the plan.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Paths, Plan
from rf_exp.datagen.motion.state import Floats
from rf_exp.datagen.obstacles import placed_at
from rf_exp.findings import About, Cause, CheckName, Finding, Violation
from rf_exp.geometry import Mask, Swept, closer_than, nearest
from rf_exp.robots import Arm
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix, apply, inverse
from rf_exp.types import CONTROL_DT_S, JointLimits, Scene, Schedule, Segment, Trajectory, arm_of

PERTURBATION_STEPS = (10, 25)  # shortest and longest duration of a perturbation
GAP_STEPS = (2, 8)  # between two perturbations; from 2 on, their accelerations do not add up
TALLEST = 3.0  # bound on the peak of a perturbation, in standard deviations
# Added to the default limits of a plan, still below those of every joint of the arms: 2.17 rad/s, 7.5 rad/s2.
ADDED = JointLimits(velocity_rad_s=1.2, acceleration_rad_s2=6.5)
CALM_STEPS, FADE_STEPS = 4, 16  # around gripper changes, contacts and the end: undisturbed, then fading in
CARRYING, TOGETHER = 0.4, 0.2  # share of the strength while an object is held, and held by several arms
TOUCHING = ("press", "strike", "shut")  # primitives that end in contact
PARTS = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25, 0.0)  # scales tried in turn; mirroring leads away from an object
KEEPS_M = 0.015  # clearance from objects, where the plan has it; arms lag, most where commands change fast
MOVED_M = 0.005


@dataclass
class _Perturbation:
    """Smooth deviation of all joints from a path and back, and its present scale."""

    begins: int  # the path position before the first disturbed one
    offsets_rad: Floats  # (L, dof) at full scale
    part: int = 0  # index of PARTS

    @property
    def ends(self) -> int:
        """The path position after the last disturbed one."""
        return self.begins + len(self.offsets_rad) + 1


class Disturbance:
    """Perturbations of all joints along the trajectories of a plan, reduced where a check fails.

    Ends of trajectories, gripper changes and contacts stay undisturbed; around them, and while an object is
    held, perturbations are smaller.
    """

    def __init__(
        self,
        arms: Mapping[int, Arm],
        trajectories: Sequence[Trajectory],
        schedule: Schedule,
        strength_rad: float,
        rng: np.random.Generator,
    ) -> None:
        """`strength_rad` is the standard deviation of the peaks; `schedule` tells when arms wait."""
        self._trajectories = tuple(trajectories)
        self._kept = {  # agent -> perturbations
            each.agent: _perturbations(arms[each.agent], each, schedule, strength_rad, rng)
            for each in trajectories
        }

    def trajectories(self) -> tuple[Trajectory, ...]:
        """The trajectories with the perturbations at their present scales."""
        return tuple(map(self._disturbed, self._trajectories))

    def lessen(self, wrong: Collection[tuple[int, int]]) -> bool:
        """Mirrors, reduces or drops the perturbations at wrong places (agent, path position).

        If no perturbation covers any of the places, the nearest ones. Returns whether there were any.
        """
        found = [each for each in (self._nearest(*place) for place in wrong) if each is not None]
        least = min((away for _, away in found), default=0)
        lessened = {id(kept): kept for kept, away in found if away == 0 or least > 0}
        for kept in lessened.values():
            kept.part += 1
        return bool(lessened)

    def _nearest(self, agent: int, position: int) -> tuple[_Perturbation, int] | None:
        """The remaining perturbation of an agent nearest to a path position, and its distance in steps."""
        left = [each for each in self._kept[agent] if PARTS[each.part]]
        away = [max(each.begins - position, position - each.ends, 0) for each in left]
        return min(zip(left, away, strict=True), key=lambda each: each[1], default=None)

    def _disturbed(self, trajectory: Trajectory) -> Trajectory:
        offsets = np.zeros_like(arm_of(trajectory.path()))  # per path position
        for each in self._kept[trajectory.agent]:
            offsets[each.begins + 1 : each.ends] = PARTS[each.part] * each.offsets_rad
        segments: list[Segment] = []
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            qpos = segment.qpos + offsets[end - len(segment) + 1 : end + 1]
            segments.append(replace(segment, qpos=qpos))
        return replace(trajectory, segments=tuple(segments))


def _perturbations(
    arm: Arm, trajectory: Trajectory, schedule: Schedule, strength_rad: float, rng: np.random.Generator
) -> list[_Perturbation]:
    """The perturbations of one agent, in their order along its path."""
    positions = schedule.positions[:, trajectory.agent - 1]
    share, steps, found = _share(trajectory), len(trajectory), list[_Perturbation]()
    begins = int(rng.integers(0, GAP_STEPS[1] + 1))
    while begins < steps:
        length = int(rng.integers(PERTURBATION_STEPS[0], PERTURBATION_STEPS[1] + 1))
        tops = strength_rad * np.clip(rng.normal(size=len(trajectory.start_qpos)), -TALLEST, TALLEST)
        shape = np.sin(np.pi * (np.arange(length) + 1) / (length + 1)) ** 2
        part = share[begins : begins + length]
        offsets = shape[: len(part), None] * part[:, None] * tops
        if offsets.any():
            bounded = _bounded(offsets, begins, trajectory, positions, arm.robot.limits_rad)
            found.append(_Perturbation(begins, bounded))
        begins += length + int(rng.integers(GAP_STEPS[0], GAP_STEPS[1] + 1))
    return found


def _bounded(
    offsets_rad: Floats, begins: int, trajectory: Trajectory, positions: NDArray[np.int64], limits_rad: Floats
) -> Floats:
    """The perturbation, scaled down per joint where it exceeds `ADDED` or, also mirrored, a joint limit.

    `positions` (T + 1,) are the path positions of the agent over time.
    """
    moved, qpos = slice(begins + 1, begins + len(offsets_rad) + 1), arm_of(trajectory.path())
    path = np.zeros_like(qpos)
    path[moved] = offsets_rad
    added = np.pad(path[positions], ((1, 1), (0, 0)), mode="edge")  # a waiting arm stops at once
    velocity = np.diff(added, axis=0) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_DT_S
    fastest, hardest = (np.abs(each).max(axis=0) for each in (velocity, acceleration))
    low, high = limits_rad
    room = np.maximum(np.minimum(qpos[moved] - low, high - qpos[moved]), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = [ADDED.velocity_rad_s / fastest, ADDED.acceleration_rad_s2 / hardest]
        parts += [np.nanmin(room / np.abs(offsets_rad), axis=0)]
    return offsets_rad * np.minimum(np.nanmin(parts, axis=0), 1.0)


def _share(trajectory: Trajectory) -> Floats:
    """(P,) share of the strength at each path position, beginning with the first after the start."""
    steps = len(trajectory)
    part, calm = np.ones(steps), np.zeros(steps, dtype=bool)
    for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
        span = slice(end - len(segment), end)
        if segment.joined is not None:
            part[span] = TOGETHER
        elif segment.attached is not None:
            part[span] = CARRYING
        if segment.primitive in ("open", "close"):
            calm[span] = True
        elif segment.primitive in TOUCHING:
            calm[end - 1] = True
    calm[-1:] = True  # the next plan begins where this one ends
    still = np.flatnonzero(calm)
    if not len(still):
        return part
    apart = np.abs(np.arange(steps)[:, None] - still[None, :]).min(axis=1)
    return part * np.clip((apart - CALM_STEPS) / FADE_STEPS, 0.0, 1.0)


def nearer(plan: Plan, disturbed: Paths) -> Iterator[tuple[int, int]]:
    """Agents and path positions at which disturbed paths come nearer to an object at rest than the plan does.

    Includes objects about to be grasped: checks do not limit how a gripper approaches what it may touch.
    """
    for agent, body in zip(plan.task.agents, disturbed.swept, strict=True):
        paths = (arm_of(each.trajectory(agent).path()) for each in (plan.paths, disturbed))
        moved = (np.subtract(*paths) != 0).any(axis=1)
        for name in plan.task.objects:
            for pose, steps in _at_rest(plan, name):
                rows = np.unique(plan.positions(agent)[steps])
                rows = rows[moved[rows]]
                if not len(rows):
                    continue
                still = placed_at(plan.task, plan.scene, name, pose)
                bodies = [_whole(each, rows, name) for each in (plan.paths.swept[agent - 1], body)]
                for row in np.flatnonzero(closer_than(bodies[1], still, KEEPS_M, between=False)[:, 0]):
                    at = np.array([[row, 0]])
                    meant_m, found_m = (nearest(each, still, at).distance_m for each in bodies)
                    if found_m < min(meant_m, KEEPS_M):
                        yield agent, int(rows[row])


def _at_rest(plan: Plan, name: str) -> Iterator[tuple[Matrix, Mask]]:
    """The poses of an object while no agent moves it, each with a mask (T + 1,) of the steps of the plan."""
    steps = len(plan.schedule) + 1
    movers = np.zeros(steps, int)  # agent that moves it now, or moved it last
    moves = np.zeros(steps, bool)
    for agent, body in zip(plan.task.agents, plan.paths.swept, strict=True):
        if name in body.carried:
            carried = body.carried[name][plan.positions(agent)]
            moves |= carried
            movers[carried] = agent
    last = np.maximum.accumulate(np.where(moves, np.arange(steps), -1))
    for since in np.unique(last[~moves]).tolist():
        pose = plan.scene.poses[name]
        if since >= 0:
            agent = int(movers[since])
            body = plan.paths.swept[agent - 1]
            pose = body.poses[plan.positions(agent)[since], body.labels.index(name)]
        yield pose, ~moves & (last == since)


def _whole(body: Swept, rows: NDArray[np.int64], name: str) -> Swept:
    """A body at some of its positions, without one object and without permitted contacts."""
    of = np.array([k for k, label in enumerate(body.labels) if label != name])
    pieces, labels = tuple(body.pieces[k] for k in of), tuple(body.labels[k] for k in of)
    carried = {each: mask[rows] for each, mask in body.carried.items() if each != name}
    return Swept(
        pieces, labels, body.poses[np.ix_(rows, of)], body.objects - {name}, carried, gripper=body.gripper
    )


class ObjectMotionWatch:
    """Monitor of clutter, and of the objects of a plan that no agent handles: they must not move."""

    def __init__(self, plan: Plan, *, objects: bool) -> None:
        """`plan` is the one being executed; without `objects`, only clutter is watched."""
        self._plan, self._objects = plan, objects
        self._rest = self._places_m(plan.scene)

    def unintended(self, scene: Scene) -> Violation | None:
        """The violation for the first object that moved without being handled, if any."""
        handled = self._handled(scene) if self._objects else ()
        for name, here in self._places_m(scene).items():
            if name in handled:
                self._rest[name] = here
            elif (moved_m := float(np.linalg.norm(here - self._rest[name]))) > MOVED_M:
                finding = Finding.CLUTTER_MOVED if name in scene.clutter else Finding.OBJECT_MOVED
                facts: About = {"measured": True, "object": name}
                check, cause, time_s = CheckName.OBJECT_MOTION, Cause.CONTACT, scene.time_s
                return Violation(
                    finding, moved_m, MOVED_M, "m", check=check, cause=cause, time_s=time_s, **facts
                )
        return None

    def _places_m(self, scene: Scene) -> dict[str, Floats]:
        """Positions (3,) of everything that is watched."""
        poses = {**scene.clutter, **scene.poses} if self._objects else scene.clutter
        return {name: pose[:3, 3] for name, pose in poses.items()}

    def _handled(self, scene: Scene) -> set[str]:
        """Objects held or touched on purpose, with contents. An approaching arm must not move its object."""
        found = {name for name in scene.held if name is not None}
        for agent in self._plan.task.agents:
            position = self._plan.position_now(agent, scene)
            segment = self._plan.trajectory(agent).segment_at(position) if position > 0 else None
            if segment is not None and segment.primitive != "approach":
                found |= segment.touches
        return found | {
            name for name in scene.poses for into in found if _lies_in(self._plan.task, scene, name, into)
        }


def _lies_in(task: Task, scene: Scene, name: str, into: str) -> bool:
    """Whether an object lies inside a container, with which it moves."""
    asset = task.asset(into)
    if not any(point.kind == "drop" for point in asset.points.values()):
        return False
    here = apply(inverse(scene.poses[into]), scene.poses[name][:3, 3])
    return name != into and bool(((asset.bounds_m[0] < here) & (here < asset.bounds_m[1])).all())
