"""Disturbed motion: demonstrations of recovery (DART, Laskey et al. 2017).

The arms execute their paths with smooth perturbations added, while the intended commands are the ones that
are learned: they show a policy what leads back from states off the path. Perturbations are added to path
positions, not to time steps, so that the disturbed motion is a trajectory like any other, run by the same
schedule and judged by the same checks. A disturbed arm keeps clear of objects, whose motion is monitored.

Perturbations are bounded: by `MAX_PEAK_STD` standard deviations, and by `PERTURBATION_LIMITS` in velocity
and acceleration of a joint. Disturbed motion stays within the sum of these and the limits of the plan.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Paths, Plan
from rf_exp.datagen.motion.state import Floats
from rf_exp.datagen.obstacles import body_at
from rf_exp.findings import Cause, CheckName, FactArguments, Finding, Violation
from rf_exp.geometry import Mask, Swept, closer_than, nearest
from rf_exp.robots import Arm
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix, apply, inverse
from rf_exp.types import CONTROL_DT_S, JointLimits, Scene, Schedule, Segment, Trajectory, arm_of

PERTURBATION_STEPS = (10, 25)  # shortest and longest duration of a perturbation
GAP_STEPS = (2, 8)  # between two perturbations; from 2 on, their accelerations do not add up
MAX_PEAK_STD = 3.0  # bound on the peak of a perturbation, in standard deviations
# Added to the default limits of a plan, still below those of every joint of the arms: 2.17 rad/s, 7.5 rad/s2.
PERTURBATION_LIMITS = JointLimits(velocity_rad_s=1.2, acceleration_rad_s2=6.5)
UNDISTURBED_STEPS, FADE_STEPS = 4, 16  # near gripper changes, contacts, the end: undisturbed, then fading in
HELD_STRENGTH, JOINTLY_HELD_STRENGTH = 0.4, 0.2  # share of it while one arm, or several, hold an object
CONTACT_PRIMITIVES = ("press", "strike", "shut")  # primitives that end in contact
SCALES = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25, 0.0)  # tried in turn; mirroring leads away from an object
OBJECT_CLEARANCE_M = 0.015  # where the plan has it; arms lag, most where commands change fast
MOTION_TOLERANCE_M = 0.005


@dataclass
class _Perturbation:
    """Smooth deviation of all joints from a path and back, and its present scale."""

    start: int  # the path position before the first disturbed one
    offsets_rad: Floats  # (L, dof) at full scale
    scale_index: int = 0  # index of SCALES

    @property
    def end(self) -> int:
        """The path position after the last disturbed one."""
        return self.start + len(self.offsets_rad) + 1


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
        self._perturbations = {  # agent -> perturbations
            each.agent: _sample_perturbations(arms[each.agent], each, schedule, strength_rad, rng)
            for each in trajectories
        }

    def trajectories(self) -> tuple[Trajectory, ...]:
        """The trajectories with the perturbations at their present scales."""
        return tuple(map(self._disturbed, self._trajectories))

    def reduce(self, places: Collection[tuple[int, int]]) -> bool:
        """Mirrors, reduces or drops the perturbations at wrong places (agent, path position).

        If no perturbation covers any of the places, the nearest ones. Returns whether there were any.
        """
        nearest = [found for found in (self._nearest(*place) for place in places) if found is not None]
        min_distance = min((distance for _, distance in nearest), default=0)
        reduced = {id(each): each for each, distance in nearest if distance == 0 or min_distance > 0}
        for perturbation in reduced.values():
            perturbation.scale_index += 1
        return bool(reduced)

    def _nearest(self, agent: int, position: int) -> tuple[_Perturbation, int] | None:
        """The remaining perturbation of an agent nearest to a path position, and its distance in steps."""
        remaining = [each for each in self._perturbations[agent] if SCALES[each.scale_index]]
        distances = [max(each.start - position, position - each.end, 0) for each in remaining]
        return min(zip(remaining, distances, strict=True), key=lambda each: each[1], default=None)

    def _disturbed(self, trajectory: Trajectory) -> Trajectory:
        offsets = np.zeros_like(arm_of(trajectory.path()))  # per path position
        for each in self._perturbations[trajectory.agent]:
            offsets[each.start + 1 : each.end] = SCALES[each.scale_index] * each.offsets_rad
        segments: list[Segment] = []
        for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
            qpos = segment.qpos + offsets[end - len(segment) + 1 : end + 1]
            segments.append(replace(segment, qpos=qpos))
        return replace(trajectory, segments=tuple(segments))


def _sample_perturbations(
    arm: Arm, trajectory: Trajectory, schedule: Schedule, strength_rad: float, rng: np.random.Generator
) -> list[_Perturbation]:
    """The perturbations of one agent, in their order along its path."""
    positions = schedule.positions[:, trajectory.agent - 1]
    strength, steps, perturbations = _strength_profile(trajectory), len(trajectory), list[_Perturbation]()
    start = int(rng.integers(0, GAP_STEPS[1] + 1))
    while start < steps:
        length = int(rng.integers(PERTURBATION_STEPS[0], PERTURBATION_STEPS[1] + 1))
        samples = rng.normal(size=len(trajectory.start_qpos))
        peaks = strength_rad * np.clip(samples, -MAX_PEAK_STD, MAX_PEAK_STD)
        shape = np.sin(np.pi * (np.arange(length) + 1) / (length + 1)) ** 2
        scales = strength[start : start + length]
        offsets = shape[: len(scales), None] * scales[:, None] * peaks
        if offsets.any():
            limited = _within_limits(offsets, start, trajectory, positions, arm.robot.limits_rad)
            perturbations.append(_Perturbation(start, limited))
        start += length + int(rng.integers(GAP_STEPS[0], GAP_STEPS[1] + 1))
    return perturbations


def _within_limits(
    offsets_rad: Floats, start: int, trajectory: Trajectory, positions: NDArray[np.int64], limits_rad: Floats
) -> Floats:
    """The perturbation, scaled down per joint where it exceeds `PERTURBATION_LIMITS` or, also mirrored, a
    joint limit.

    `positions` (T + 1,) are the path positions of the agent over time.
    """
    moved, qpos = slice(start + 1, start + len(offsets_rad) + 1), arm_of(trajectory.path())
    path = np.zeros_like(qpos)
    path[moved] = offsets_rad
    deviations = np.pad(path[positions], ((1, 1), (0, 0)), mode="edge")  # a waiting arm stops at once
    velocity = np.diff(deviations, axis=0) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_DT_S
    peak_velocity, peak_acceleration = (np.abs(rates).max(axis=0) for rates in (velocity, acceleration))
    low, high = limits_rad
    margins = np.maximum(np.minimum(qpos[moved] - low, high - qpos[moved]), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scales = [
            PERTURBATION_LIMITS.velocity_rad_s / peak_velocity,
            PERTURBATION_LIMITS.acceleration_rad_s2 / peak_acceleration,
            np.nanmin(margins / np.abs(offsets_rad), axis=0),
        ]
    return offsets_rad * np.minimum(np.nanmin(scales, axis=0), 1.0)


def _strength_profile(trajectory: Trajectory) -> Floats:
    """(P,) share of the strength at each path position, beginning with the first after the start."""
    steps = len(trajectory)
    strength, undisturbed = np.ones(steps), np.zeros(steps, dtype=bool)
    for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
        span = slice(end - len(segment), end)
        if segment.joined is not None:
            strength[span] = JOINTLY_HELD_STRENGTH
        elif segment.attached is not None:
            strength[span] = HELD_STRENGTH
        if segment.primitive in ("open", "close"):
            undisturbed[span] = True
        elif segment.primitive in CONTACT_PRIMITIVES:
            undisturbed[end - 1] = True
    undisturbed[-1:] = True  # the next plan begins where this one ends
    undisturbed_at = np.flatnonzero(undisturbed)
    if not len(undisturbed_at):
        return strength
    distance = np.abs(np.arange(steps)[:, None] - undisturbed_at[None, :]).min(axis=1)
    return strength * np.clip((distance - UNDISTURBED_STEPS) / FADE_STEPS, 0.0, 1.0)


def clearance_losses(plan: Plan, disturbed: Paths) -> Iterator[tuple[int, int]]:
    """Agents and path positions at which disturbed paths come nearer to an object at rest than the plan does.

    Includes objects about to be grasped: checks do not limit how a gripper approaches what it may touch.
    """
    for agent, body in zip(plan.task.agents, disturbed.swept, strict=True):
        paths = (arm_of(each.trajectory(agent).path()) for each in (plan.paths, disturbed))
        is_disturbed = (np.subtract(*paths) != 0).any(axis=1)
        for name in plan.task.objects:
            for pose, steps in _resting_poses(plan, name):
                rows = np.unique(plan.positions(agent)[steps])
                rows = rows[is_disturbed[rows]]
                if not len(rows):
                    continue
                object_body = body_at(plan.task, plan.scene, name, pose)
                bodies = [_without_object(each, rows, name) for each in (plan.paths.swept[agent - 1], body)]
                near = closer_than(bodies[1], object_body, OBJECT_CLEARANCE_M, between=False)
                for row in np.flatnonzero(near[:, 0]):
                    at = np.array([[row, 0]])
                    planned_m, disturbed_m = (nearest(each, object_body, at).distance_m for each in bodies)
                    if disturbed_m < min(planned_m, OBJECT_CLEARANCE_M):
                        yield agent, int(rows[row])


def _resting_poses(plan: Plan, name: str) -> Iterator[tuple[Matrix, Mask]]:
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


def _without_object(body: Swept, rows: NDArray[np.int64], name: str) -> Swept:
    """A body at some of its positions, without one object and without permitted contacts."""
    kept = np.array([k for k, label in enumerate(body.labels) if label != name])
    pieces, labels = tuple(body.pieces[k] for k in kept), tuple(body.labels[k] for k in kept)
    carried = {each: mask[rows] for each, mask in body.carried.items() if each != name}
    return Swept(
        pieces, labels, body.poses[np.ix_(rows, kept)], body.objects - {name}, carried, gripper=body.gripper
    )


class ObjectMotionWatch:
    """Monitor of clutter, and of the objects of a plan that no agent handles: they must not move."""

    def __init__(self, plan: Plan, *, objects: bool) -> None:
        """`plan` is the one being executed; without `objects`, only clutter is watched."""
        self._plan, self._objects = plan, objects
        self._rest_m = self._positions_m(plan.scene)

    def unintended_motion(self, scene: Scene) -> Violation | None:
        """The violation for the first object that moved without being handled, if any."""
        handled = self._handled(scene) if self._objects else ()
        for name, position_m in self._positions_m(scene).items():
            if name in handled:
                self._rest_m[name] = position_m
            elif (moved_m := float(np.linalg.norm(position_m - self._rest_m[name]))) > MOTION_TOLERANCE_M:
                finding = Finding.CLUTTER_MOVED if name in scene.clutter else Finding.OBJECT_MOVED
                facts: FactArguments = {"measured": True, "object": name}
                return Violation(
                    finding,
                    moved_m,
                    MOTION_TOLERANCE_M,
                    "m",
                    check=CheckName.OBJECT_MOTION,
                    cause=Cause.CONTACT,
                    time_s=scene.time_s,
                    **facts,
                )
        return None

    def _positions_m(self, scene: Scene) -> dict[str, Floats]:
        """Positions (3,) of everything that is watched."""
        poses = {**scene.clutter, **scene.poses} if self._objects else scene.clutter
        return {name: pose[:3, 3] for name, pose in poses.items()}

    def _handled(self, scene: Scene) -> set[str]:
        """Objects held or touched on purpose, with contents. An approaching arm must not move its object."""
        handled = {name for name in scene.held if name is not None}
        for agent in self._plan.task.agents:
            position = self._plan.position_now(agent, scene)
            segment = self._plan.trajectory(agent).segment_at(position) if position > 0 else None
            if segment is not None and segment.primitive != "approach":
                handled |= segment.touches
        task = self._plan.task
        return handled | {
            name for name in scene.poses for into in handled if _is_inside(task, scene, name, into)
        }


def _is_inside(task: Task, scene: Scene, name: str, container: str) -> bool:
    """Whether an object lies inside a container, with which it moves."""
    asset = task.asset(container)
    if not any(point.kind == "drop" for point in asset.points.values()):
        return False
    position_m = apply(inverse(scene.poses[container]), scene.poses[name][:3, 3])
    low_m, high_m = asset.bounds_m
    return name != container and bool(((low_m < position_m) & (position_m < high_m)).all())
