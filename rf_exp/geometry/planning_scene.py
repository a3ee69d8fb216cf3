"""Planning scene: arms along joint positions, agents along trajectories with the objects that they move, and
static objects, as `Swept` bodies. World frame, metres, radians.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.geometry.clearance import Nearest, nearest
from rf_exp.geometry.falling import pose_after_drop
from rf_exp.geometry.swept import Mask, Swept, arm_pieces, asset_pieces, lowest_m
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix
from rf_exp.types import FINGERS, Scene, Segment, Trajectory, arm_of, fingers_of, gripper_of

AGENT_MARGIN_M = 0.01  # between two arms: tracking errors of both
OBJECT_MARGIN_M = 0.003  # between an arm and objects that it may not touch
TABLE_MARGIN_M = 0.0  # fingertips work a few millimetres above the table
RESTING_GAP_M = 0.005  # objects closer than this lie on or against one another
CLOSING_STEPS = 8  # control steps that fingers may need to close


class PlanningScene:
    """Arms and objects of a task in a measured scene. Raises ArgumentError for unknown attached objects."""

    def __init__(self, task: Task, scene: Scene, trajectories: Sequence[Trajectory] = ()) -> None:
        self.task, self.scene = task, scene
        self.arms = tuple(task.arms.values())
        self.trajectories = {trajectory.agent: trajectory for trajectory in trajectories}
        moved = {segment.attached for trajectory in trajectories for segment in trajectory.segments}
        self.moved = frozenset(name for name in moved if name)
        unknown = self.moved - set(task.objects)
        if unknown:
            raise unknown_choice("attached object", min(unknown), task.objects)

    # bodies

    def arm(
        self,
        agent: int,
        qpos: NDArray[np.float64],
        *,
        attached: str | None = None,
        tcp_from_object: Matrix | None = None,
        touches: Iterable[str] | None = None,
    ) -> Swept:
        """An arm at joint positions (P, D) rad and metres, or (P, dof) with open fingers.

        `attached` is an object that moves with the TCP; `touches` are objects that the gripper and the
        attached object may touch, by default the object that the agent holds in the scene. Raises
        ArgumentError for an attached object without `tcp_from_object`.
        """
        qpos, arm = np.atleast_2d(qpos), self.arms[agent - 1]
        if qpos.shape[1] == arm.robot.dof:
            qpos = np.hstack([qpos, np.full((len(qpos), FINGERS), arm.robot.hand.open_m)])
        moved = {}
        if attached is not None:
            if tcp_from_object is None:
                raise ArgumentError(
                    f"agent {agent} has {attached!r} attached, but tcp_from_object is missing"
                )
            moved = {attached: arm.tcp(qpos) @ tcp_from_object}
        return self._holding(agent, arm.links(qpos), moved, touches)

    def measured(
        self, agent: int, *, attached: str | None = None, touches: Iterable[str] | None = None
    ) -> Swept:
        """An arm as measured in the scene (P = 1), with an `attached` object at its measured pose."""
        moved = {} if attached is None else {attached: self.scene.poses[attached][None]}
        return self._holding(agent, self.links[agent - 1][None], moved, touches)

    def along(self, trajectory: Trajectory) -> Swept:
        """An agent along its trajectory, with every object that it moves.

        Path position p lies in the segment that ends at or after p. An object is at its pick-up pose until
        it is carried, and at its release pose afterwards, so that it blocks others there.
        """
        agent, path = trajectory.agent, trajectory.path()
        arm = self.arms[agent - 1]
        qpos = np.hstack([arm_of(path), self._openings_m(trajectory)[:, None].repeat(FINGERS, axis=1)])
        moved: dict[str, NDArray[np.float64]] = {}
        carried: dict[str, Mask] = {}
        names = dict.fromkeys(segment.attached for segment in trajectory.segments if segment.attached)
        tcp = arm.tcp(path) if names else np.empty(0)
        for name in names:
            poses = np.empty((len(path), 4, 4))
            mask = np.zeros(len(path), dtype=bool)
            for segment, begin, end in trajectory.intervals:
                if segment.attached != name:
                    continue
                if not mask.any():  # pose in the scene, or where another agent has put it
                    pushed = segment.hinge_rad is not None
                    poses[:] = self.scene.poses[name] if pushed else self.attached(segment, tcp[begin])
                mask[begin : end + 1] = True
                poses[begin + 1 : end + 1] = self.attached(segment, tcp[begin + 1 : end + 1])
                poses[end:] = poses[end]
                # It falls when the fingers are open, and counts as carried until then.
                opened = next((knot for knot in trajectory.knots if knot > end), len(poses))
                poses[opened:] = pose_after_drop(self.task, segment.subgoal, poses[end], self.scene.poses)
            moved[name], carried[name] = poses, mask
        touches = self._during(trajectory, lambda segment: segment.touches | {segment.attached})
        holds = dict(carried)
        held = self.scene.held[agent - 1]
        if held is not None:  # until the end of the releasing segment
            opens = (end for segment, _, end in trajectory.intervals if (segment.gripper > 0).any())
            gripped = np.arange(len(path)) <= next(opens, len(trajectory))
            holds[held] = holds.get(held, gripped) | gripped
            touches[held] = touches[held] | gripped
        rests = self._rests(trajectory, moved, carried)
        links = arm.links(qpos)
        return self._body(agent, links, moved, carried=carried, touches=touches, rests=rests, holds=holds)

    def attached(
        self, segment: Segment, tcp: NDArray[np.float64], rows: slice | int = slice(None)
    ) -> NDArray[np.float64]:
        """world_from_object (..., 4, 4) of the object that a segment moves, for TCP poses (..., 4, 4).

        `rows` are the corresponding rows of `hinge_rad`. Raises ArgumentError for a segment without
        `tcp_from_object`.
        """
        if segment.attached is not None and segment.hinge_rad is not None:
            return self.task.hinged_poses(segment.attached, self.scene.poses, segment.hinge_rad[rows])
        if segment.tcp_from_object is None:
            raise ArgumentError(
                f"agent {segment.agent}, segment {segment.primitive!r} has {segment.attached!r} attached, "
                "but tcp_from_object is missing"
            )
        return tcp @ segment.tcp_from_object

    def static_objects(self, names: Iterable[str] | None = None) -> Swept:
        """Objects at their poses in the scene (P = 1); by default clutter and objects that no agent moves."""
        if names is None:
            names = [name for name in (*self.task.objects, *self.task.clutter) if name not in self.moved]
        labelled_pieces = [(piece, name) for name in names for piece in asset_pieces(self._asset(name))]
        poses = np.array([self._pose(name) for _, name in labelled_pieces]).reshape(1, -1, 4, 4)
        labels = tuple(name for _, name in labelled_pieces)
        return Swept(tuple(piece for piece, _ in labelled_pieces), labels, poses, objects=frozenset(labels))

    # questions

    def between(self, a: int, b: int) -> Nearest:
        """The exact distance of two arms as measured in the scene."""
        return nearest(self.measured(a), self.measured(b))

    @staticmethod
    def below_table(body: Swept) -> Mask:
        """Mask (P,), True where a link other than the base, or a carried object, is inside the table."""
        return lowest_m(body) < TABLE_MARGIN_M

    # parts

    def _pose(self, name: str) -> Matrix:
        """Pose of an object or a piece of clutter; clutter that was not measured is at its initial pose."""
        if name in self.task.clutter:
            return self.scene.clutter.get(name, self.task.clutter[name].world_from_object)
        return self.scene.poses[name]

    def _asset(self, name: str) -> Asset:
        if name not in self.task.objects and name not in self.task.clutter:
            raise unknown_choice("object", name, self.task.objects)
        return self.task.asset(name)

    @cached_property
    def links(self) -> Sequence[NDArray[np.float64]]:
        """World poses (L, 4, 4) of the links of each arm in the scene."""
        first, *others = self.arms
        if any(arm.robot != first.robot for arm in others):
            return [arm.links(qpos) for arm, qpos in zip(self.arms, self.scene.qpos, strict=True)]
        bases = np.stack([arm.world_from_base for arm in self.arms])
        return list(bases[:, None] @ first.robot.link_poses(self.scene.qpos))

    def _holding(
        self,
        agent: int,
        links: NDArray[np.float64],
        moved: Mapping[str, NDArray[np.float64]],
        touches: Iterable[str] | None,
    ) -> Swept:
        """A body that holds everything that moves with it, at all positions."""
        held = self.scene.held[agent - 1] if touches is None else None
        everywhere = np.ones(len(links), dtype=bool)
        carried = {name: everywhere for name in moved}
        holds = {name: everywhere for name in (*moved, *((held,) if held else ()))}
        allowed = {name: everywhere for name in {*(touches or ()), *holds}}
        return self._body(agent, links, moved, carried=carried, touches=allowed, rests=allowed, holds=holds)

    def _body(
        self,
        agent: int,
        links: NDArray[np.float64],
        moved: Mapping[str, NDArray[np.float64]],
        **masks: Mapping[str, Mask],
    ) -> Swept:
        robot, mounted = self.arms[agent - 1].robot, self.task.robots[agent - 1].mounted
        pieces, labels, poses = [*arm_pieces(robot)], [*robot.links], [links]
        attachments = [(name, self._asset(name), object_poses) for name, object_poses in moved.items()]
        if mounted:
            attachments.insert(0, (robot.hand.link, mounted, links[:, robot.links.index(robot.hand.link)]))
        for label, asset, object_poses in attachments:
            for piece in asset_pieces(asset):
                pieces.append(piece)
                labels.append(label)
                poses.append(object_poses[:, None])
        return Swept(
            tuple(pieces),
            tuple(labels),
            np.concatenate(poses, axis=1),
            objects=frozenset(moved),
            gripper=robot.gripper,
            base=robot.links[0],
            **masks,
        )

    def _during(self, trajectory: Trajectory, names: Callable[[Segment], Set[str | None]]) -> dict[str, Mask]:
        """Object -> (P,) True in segments whose `names` include it; a knot belongs to both segments."""
        masks = {name: np.zeros(len(trajectory) + 1, dtype=bool) for name in self.task.objects}
        for segment, begin, end in trajectory.intervals:
            for name in masks.keys() & names(segment):
                masks[name][begin : end + 1] = True
        return masks

    def _openings_m(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Opening (P,) of each finger; never less than the real one while the fingers close."""
        hand = self.arms[trajectory.agent - 1].robot.hand
        opening = hand.opening_m(gripper_of(trajectory.path()))
        for segment, begin, end in trajectory.intervals:
            if segment.grasped_object:
                rows = slice(begin + 1, end + 1)
                opening[rows] = np.maximum(opening[rows], self._grip_m(trajectory, segment.grasped_object))
        opening[0] = max(opening[0], float(fingers_of(self.scene.qpos[trajectory.agent - 1]).max()))
        return maximum_filter1d(opening, CLOSING_STEPS + 1, origin=CLOSING_STEPS // 2, mode="nearest")

    def _grip_m(self, trajectory: Trajectory, name: str) -> float:
        """Opening in m of each finger that holds an object."""
        agent = trajectory.agent
        if self.scene.held[agent - 1] == name:
            return float(fingers_of(self.scene.qpos[agent - 1]).max())
        points = self.task.asset(name).points
        for segment in trajectory.segments:
            point = segment.subgoal.point
            if segment.subgoal.object == name and point is not None and point in points:
                return points[point].width_m / 2
        return self.arms[agent - 1].robot.hand.open_m

    def _rests(
        self,
        trajectory: Trajectory,
        moved: Mapping[str, NDArray[np.float64]],
        carried: Mapping[str, Mask],
    ) -> dict[str, Mask]:
        """Allowed contacts of carried objects: what a segment names, and what they lie on at either end.

        A lid may scrape the pot during the segment that lifts it off, a cube the cube that it is placed on.
        """
        contacts = self._during(trajectory, lambda segment: segment.touches)
        knots = np.array(trajectory.knots)
        for name, poses in moved.items():
            # Objects that agents move may be gone by then; if one is the target, the segment names it.
            others = [other for other in self.task.objects if other != name and other not in self.moved]
            carried_positions = np.flatnonzero(carried[name])
            body, mask = self.static_objects([name]), {name: np.ones(1, dtype=bool)}
            for first, position in ((True, int(carried_positions[0])), (False, int(carried_positions[-1]))):
                end = knots[knots > position].min() if first else position
                begin = position if first else knots[knots < position].max()
                poses_there = np.tile(poses[position], (1, len(body.pieces), 1, 1))
                body_there = replace(body, poses=poses_there, carried=mask)
                for other in others:
                    if nearest(body_there, self.static_objects([other])).distance_m < RESTING_GAP_M:
                        contacts[other][begin : end + 1] = True
        return contacts
