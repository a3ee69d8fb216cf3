"""The start of an episode, drawn from its seed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint, Polygon
from shapely.geometry.base import BaseGeometry

from rf_exp.errors import ArgumentError
from rf_exp.tasks.task.specs import beyond_edge
from rf_exp.tasks.task.variation import NO_DEVICE_ERRORS, DeviceErrors, draw
from rf_exp.transforms import Matrix, apply, inverse, planar
from rf_exp.types import FINGERS, SCENE, Light, Look, Scene, fingers_of, joints_of

if TYPE_CHECKING:
    import trimesh

    from rf_exp.tasks.task.task import Task

MIN_OBJECT_GAP_M = 0.005  # least distance between objects at the start
MIN_ARM_OBJECT_GAP_M = 0.01  # least distance between an arm and an object
MIN_ARM_GAP_M = 0.03  # between vertices of two arms: checks require a third of it, but edges may be nearer
_MAX_DRAWS = 1000
_RETRACTION_STEPS = (0.1, 0.2, 0.4, 0.8)  # fractions of the way from rest to the retracted posture


@dataclass(frozen=True)
class Start:
    """Initial state of an episode."""

    seed: int
    copy: int
    qpos: NDArray[np.float64]  # (N, D) rad, metres
    poses: Mapping[str, Matrix]  # object -> world_from_object
    light: float  # relative brightness
    tints: Mapping[str, NDArray[np.float64]]  # object -> (3,) relative brightness of red, green, blue
    masses_kg: Mapping[str, float]  # object -> its mass
    devices: DeviceErrors = NO_DEVICE_ERRORS  # errors of sensors and actuators
    look: Look = field(default_factory=Look)
    lamps: Light = field(default_factory=Light)  # before scaling by `light`
    clutter: Mapping[str, Matrix] = field(default_factory=dict)  # piece -> world_from_object

    @property
    def scene(self) -> Scene:
        """The measured scene before any step, known without a simulator."""
        qvel, speeds = np.zeros_like(self.qpos), dict.fromkeys(self.poses, 0.0)
        held = (None,) * len(self.qpos)
        return Scene(0, self.qpos, qvel, self.poses, speeds, held=held, clutter=self.clutter)


def start_of(task: "Task", seed: int, copy: int = 0) -> Start:
    """The start of an episode: a pure function of task and seed; `copy` changes visual factors only.

    All objects are drawn again while any overlap. Raises ArgumentError for ranges too narrow to keep objects
    apart, and for an object that does not lie on the table.
    """
    rng = np.random.default_rng([seed, SCENE])
    for _ in range(_MAX_DRAWS):
        poses = _draw_poses(task, rng)
        crowded = _crowded(task, poses)
        if crowded is None:
            break
    else:
        raise ArgumentError(
            f"task {task.name!r}, seed {seed}: none of {_MAX_DRAWS} draws leaves {MIN_OBJECT_GAP_M} m "
            f"between the objects; in the last {crowded}; widen their ranges"
        )
    for name, pose in poses.items():
        beyond_m, edge = beyond_edge(_footprint(task, name, pose))
        if beyond_m > 0:
            raise ArgumentError(
                f"task {task.name!r}, seed {seed}: {name} would start {1000 * beyond_m:.0f} mm beyond the "
                f"table's edge at {edge} and fall; move its range, or what it is relative to"
            )
    qpos = np.zeros((len(task.robots), task.dof + FINGERS))
    drawn = draw(task, seed, copy) if task.variation.identity else None
    noise = rng.normal(0.0, task.randomisation.init_qpos_std_rad, joints_of(qpos).shape)
    for row, robot, offset in zip(qpos, task.robots, noise, strict=True):
        row[: robot.model.dof] = robot.rest_rad + offset[: robot.model.dof]
        fingers_of(row)[:] = robot.model.hand.open_m
    if drawn is not None:
        qpos = _displaced_posture(task, qpos, drawn.posture_rad, poses)
    light = 1.0 + rng.uniform(-task.randomisation.light, task.randomisation.light)
    spread = task.randomisation.colour
    tints = {name: 1.0 + rng.uniform(-spread, spread, 3) for name in task.objects}
    masses_kg = {}
    for name in task.objects:
        asset, fraction = task.asset(name), rng.uniform() * task.randomisation.mass_scale
        masses_kg[name] = asset.mass_kg + fraction * ((asset.heaviest_kg or asset.mass_kg) - asset.mass_kg)
    clutter = {name: piece.world_from_object for name, piece in task.clutter.items()}
    start = Start(seed, copy, qpos, poses, light, tints, masses_kg, clutter=clutter)
    if drawn is None:
        return start
    tints = {name: tint * drawn.tints[name] for name, tint in tints.items()}
    return replace(start, tints=tints, devices=drawn.devices, look=drawn.look, lamps=drawn.light)


def _displaced_posture(
    task: "Task", qpos: NDArray[np.float64], offsets_rad: NDArray[np.float64], poses: Mapping[str, Matrix]
) -> NDArray[np.float64]:
    """Start qpos (N, D) displaced by `offsets_rad` (N, dof); less where an arm would meet an object or arm.

    An arm that meets an object even at rest, as bases or the table have moved, is retracted step by step.
    """
    for fraction in (1.0, 0.5, 0.25, 0.0):
        displaced = qpos.copy()
        for row, robot, offset_rad in zip(displaced, task.robots, offsets_rad, strict=True):
            arm = row[: robot.model.dof]
            arm[:] = (arm + fraction * offset_rad[: robot.model.dof]).clip(*robot.model.planned_rad)
        if not offsets_rad.any():
            return displaced
        in_collision = arms_near_objects(task, displaced, poses)
        if not in_collision and not arms_near_each_other(task, displaced):
            return displaced
    for fraction in _RETRACTION_STEPS:
        for k in in_collision:
            robot = task.robots[k]
            arm, dof = displaced[k], robot.model.dof
            arm[:dof] = qpos[k, :dof] + fraction * (np.array(robot.model.aside_rad) - qpos[k, :dof])
        if not (in_collision := arms_near_objects(task, displaced, poses)):
            break
    return displaced


def arms_near_objects(task: "Task", qpos: NDArray[np.float64], poses: Mapping[str, Matrix]) -> dict[int, str]:
    """Row of an arm at qpos (N, D) -> an object of `poses` nearer than CLEAR_M; only arms that have one."""
    pieces = [(name, pose, hull) for name, pose in poses.items() for hull in task.asset(name).hulls]
    nearest_objects: dict[int, str] = {}
    for row, links in enumerate(_link_hulls(task, qpos)):
        close_objects = (
            name
            for link, link_hull in links
            for name, pose, hull in pieces
            if _closer_than(link_hull, hull, inverse(link) @ pose, MIN_ARM_OBJECT_GAP_M)
        )
        if (name := next(close_objects, None)) is not None:
            nearest_objects[row] = name
    return nearest_objects


def arms_near_each_other(task: "Task", qpos: NDArray[np.float64]) -> bool:
    """Whether any two arms at qpos (N, D) are nearer than APART_M."""
    return any(
        _closer_than(hull, other_hull, inverse(link) @ other, MIN_ARM_GAP_M)
        for a, b in combinations(_link_hulls(task, qpos), 2)
        for link, hull in a
        for other, other_hull in b
    )


def _link_hulls(task: "Task", qpos: NDArray[np.float64]) -> list[list[tuple[Matrix, "trimesh.Trimesh"]]]:
    """For each arm at qpos (N, D), the links as (world_from_link, convex hull)."""
    arms = []
    for row, arm in zip(qpos, task.arms.values(), strict=True):
        links = dict(zip(arm.robot.links, arm.links(row[None])[0], strict=True))
        arms.append([(links[link], hull) for link, hull in arm.robot.hulls.items()])
    return arms


def _closer_than(a: "trimesh.Trimesh", b: "trimesh.Trimesh", a_from_b: Matrix, least_m: float) -> bool:
    """Whether two convex meshes are nearer than `least_m`, by the vertices of each against the other's faces.

    An approximation that suffices as links and objects have many vertices.
    """
    between = apply(a_from_b, b.bounds.mean(axis=0)) - a.bounds.mean(axis=0)
    radii_m = (np.linalg.norm(a.extents) + np.linalg.norm(b.extents)) / 2
    if np.linalg.norm(between) > radii_m + least_m:
        return False
    return _any_within(a, apply(a_from_b, b.vertices), least_m) or _any_within(
        b, apply(inverse(a_from_b), a.vertices), least_m
    )


def _any_within(hull: "trimesh.Trimesh", points: NDArray[np.float64], least_m: float) -> bool:
    """Whether any point (K, 3) is inside a convex mesh or nearer than `least_m` to it."""
    outside_m = points @ hull.face_normals.T - (hull.triangles_center * hull.face_normals).sum(axis=1)
    return bool((outside_m.max(axis=1) < least_m).any())


def _draw_poses(task: "Task", rng: np.random.Generator) -> dict[str, Matrix]:
    poses: dict[str, Matrix] = {}
    for name, spec in task.objects.items():
        x_m, y_m, yaw_deg = (rng.uniform(*ends) for ends in (spec.x_m, spec.y_m, spec.yaw_deg))
        local = planar(x_m, y_m, np.deg2rad(yaw_deg), spec.z_m)
        if (hinge := task.asset(name).hinge) is not None:
            local = local @ hinge.closed_from_object(np.deg2rad(spec.open_deg))
        poses[name] = poses[spec.relative_to] @ local if spec.relative_to else local
    return poses


def beyond_table(task: "Task", name: str) -> tuple[float, str]:
    """How far (m) an object may start beyond an edge of the table, and which edge; 0 or less: not at all.

    (0, "") for an object relative to another one: its place is unknown before it is drawn.
    """
    spec = task.objects[name]
    if spec.relative_to is not None:
        return 0.0, ""
    low_deg, high_deg = spec.yaw_deg
    yaws_rad = np.deg2rad(np.linspace(low_deg, high_deg, 1 + int(np.ceil(high_deg - low_deg))))
    unrotated = _footprint(task, name, planar(0.0, 0.0, 0.0))
    corners = np.array([(x, y, 0.0) for x in spec.x_m for y in spec.y_m])
    farthest = corners + np.linalg.norm(unrotated[:, :2], axis=1).max() * np.array([[[1.0]], [[-1.0]]])
    if (beyond := beyond_edge(farthest.reshape(-1, 3)))[0] <= 0:  # at any yaw
        return beyond
    turned = [unrotated @ planar(0.0, 0.0, yaw)[:3, :3].T + corner for yaw in yaws_rad for corner in corners]
    return beyond_edge(np.concatenate(turned))


def _footprint(task: "Task", name: str, pose: Matrix) -> NDArray[np.float64]:
    """(K, 3) points that must be over the table: all vertices, or the origin of a mark or stacked object."""
    on_table = task.asset(name).hulls and not task.objects[name].z_m
    return task.asset(name).vertices(pose) if on_table else pose[None, :3, 3]


def _crowded(task: "Task", poses: Mapping[str, Matrix]) -> str | None:
    """Two objects that are too close on the table, seen from above, in words. Leaves out stacked objects."""
    outlines = {
        name: MultiPoint(task.asset(name).vertices(pose)[:, :2]).convex_hull
        for name, pose in poses.items()
        if task.asset(name).hulls and not task.objects[name].z_m
    }
    for a, b in combinations(outlines, 2):
        gap_m = outlines[a].distance(outlines[b])
        if gap_m <= 0:
            return f"{a} and {b} overlap by {1000 * _penetration_m(outlines[a], outlines[b]):.0f} mm"
        if gap_m <= MIN_OBJECT_GAP_M:
            return f"{a} and {b} are {1000 * gap_m:.1f} mm apart"
    return None


def _penetration_m(a: BaseGeometry, b: BaseGeometry) -> float:
    """Penetration depth of two overlapping convex outlines: the shortest move that separates them."""
    corners = [np.array(polygon.exterior.coords) for polygon in (a, b) if isinstance(polygon, Polygon)]
    edges = np.concatenate([np.diff(polygon, axis=0) for polygon in corners])
    normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    a_along, b_along = (polygon @ normals.T for polygon in corners)  # (K, E) along each normal
    ahead, behind = a_along.max(axis=0) - b_along.min(axis=0), b_along.max(axis=0) - a_along.min(axis=0)
    return float(np.minimum(ahead, behind).min())
