"""Things that a disturbed arm must not move: it keeps clear of them, and is watched."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Paths, Plan
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.geometry import Mask, PlanningScene, Swept, closer_than, nearest
from rf_exp.transforms import Matrix
from rf_exp.types import Scene, arm_of

KEEPS_M = 0.015  # of a thing, where its plan does: it trails its commands, the more the faster they change
MOVED_M = 0.005


def nearer(plan: Plan, disturbed: Paths) -> Iterator[tuple[int, int]]:
    """Agents and path positions at which disturbed paths lead nearer to a thing than the plan does.

    Of things at rest, also those that are about to be gripped, and where they are nearer than KEEPS_M. The
    checks of a plan leave it to a gripper how it comes to what it may touch.
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
                thing = PlanningScene(plan.task, replace(plan.scene, poses={**plan.scene.poses, name: pose}))
                still = thing.standing([name])
                bodies = [_whole(each, rows, name) for each in (plan.paths.swept[agent - 1], body)]
                for row in np.flatnonzero(closer_than(bodies[1], still, KEEPS_M, between=False)[:, 0]):
                    meant_m, found_m = (_apart_m(each, still, int(row)) for each in bodies)
                    if found_m < min(meant_m, KEEPS_M):
                        yield agent, int(rows[row])


def _at_rest(plan: Plan, name: str) -> Iterator[tuple[Matrix, Mask]]:
    """Where a thing lies while nobody moves it, and (T + 1,) in which steps of the plan."""
    steps = len(plan.schedule) + 1
    movers = np.zeros(steps, int)  # who moves it now, or has moved it last
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
    """A body at some of its positions, without a thing, and that may touch nothing."""
    of = np.array([k for k, label in enumerate(body.labels) if label != name])
    pieces, labels = tuple(body.pieces[k] for k in of), tuple(body.labels[k] for k in of)
    carried = {each: mask[rows] for each, mask in body.carried.items() if each != name}
    return Swept(
        pieces, labels, body.poses[np.ix_(rows, of)], body.objects - {name}, carried, gripper=body.gripper
    )


def _apart_m(body: Swept, still: Swept, row: int) -> float:
    found = nearest(body, still, np.array([[row, 0]]))
    return np.inf if found is None else found.distance_m


class ObjectMotionWatch:
    """Watches clutter, and the things of a plan that are not being handled: they stay where they are."""

    def __init__(self, plan: Plan, *, objects: bool) -> None:
        """`plan` is what is executed; without `objects` clutter alone is watched."""
        self._plan, self._objects = plan, objects
        self._clutter = {name: pose[:3, 3] for name, pose in plan.scene.clutter.items()}
        self._rest: dict[str, NDArray[np.float64]] = {n: pose[:3, 3] for n, pose in plan.scene.poses.items()}

    def unintended(self, scene: Scene) -> Violation | None:
        """What has moved by now that nobody handles."""
        for name, pose in scene.clutter.items():
            if (moved_m := float(np.linalg.norm(pose[:3, 3] - self._clutter[name]))) > MOVED_M:
                return _moved(scene, Finding.CLUTTER_MOVED, name, moved_m)
        if not self._objects:
            return None
        handled = self._handled(scene)
        for name, pose in scene.poses.items():
            here = pose[:3, 3]
            if name in handled:
                self._rest[name] = here
            elif (moved_m := float(np.linalg.norm(here - self._rest[name]))) > MOVED_M:
                return _moved(scene, Finding.OBJECT_MOVED, name, moved_m)
        return None

    def _handled(self, scene: Scene) -> set[str]:
        """What is held or touched on purpose. An arm that only comes close to a thing must not move it."""
        found = {name for name in scene.held if name is not None}
        for agent in self._plan.task.agents:
            position = self._plan.position_now(agent, scene)
            segment = self._plan.segment_at(agent, position) if position > 0 else None
            if segment is not None and segment.primitive != "approach":
                found |= segment.touches
        return found


def _moved(scene: Scene, finding: Finding, name: str, moved_m: float) -> Violation:
    return Violation(
        check=CheckName.OBJECT_MOTION,
        cause=Cause.CONTACT,
        finding=finding,
        value=moved_m,
        bound=MOVED_M,
        unit="m",
        time_s=scene.time_s,
        measured=True,
        object=name,
    )
