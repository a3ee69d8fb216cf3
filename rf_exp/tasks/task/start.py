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
from rf_exp.tasks.task.variation import EXACT, Devices, draw
from rf_exp.transforms import Matrix, apply, inverse, planar
from rf_exp.types import FINGERS, SCENE, Light, Look, Scene, fingers_of, joints_of

if TYPE_CHECKING:
    import trimesh

    from rf_exp.tasks.task.task import Task

GAP_M = 0.005  # least distance between objects at the start
CLEAR_M = 0.01  # least distance between an arm and an object
APART_M = 0.03  # between vertices of two arms: the checks require a third of it, and edges may be nearer
_DRAWS = 1000
_DRAWN_IN = (0.1, 0.2, 0.4, 0.8)  # fractions of the way from rest to the retracted posture


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
    devices: Devices = EXACT  # errors of sensors and actuators
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
    for _ in range(_DRAWS):
        poses = _drawn(task, rng)
        crowded = _crowded(task, poses)
        if crowded is None:
            break
    else:
        raise ArgumentError(
            f"task {task.name!r}, seed {seed}: none of {_DRAWS} draws leaves {GAP_M} m between the "
            f"objects; in the last {crowded}; widen their ranges"
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
    for row, robot, off in zip(qpos, task.robots, noise, strict=True):
        row[: robot.model.dof] = robot.rest_rad + off[: robot.model.dof]
        fingers_of(row)[:] = robot.model.hand.open_m
    if drawn is not None:
        qpos = _postured(task, qpos, drawn.posture_rad, poses)
    light = 1.0 + rng.uniform(-task.randomisation.light, task.randomisation.light)
    spread = task.randomisation.colour
    tints = {name: 1.0 + rng.uniform(-spread, spread, 3) for name in task.objects}
    masses_kg = {}
    for name in task.objects:
        asset, part = task.asset(name), rng.uniform() * task.randomisation.mass_scale
        masses_kg[name] = asset.mass_kg + part * ((asset.heaviest_kg or asset.mass_kg) - asset.mass_kg)
    clutter = {name: piece.world_from_object for name, piece in task.clutter.items()}
    start = Start(seed, copy, qpos, poses, light, tints, masses_kg, clutter=clutter)
    if drawn is None:
        return start
    tints = {name: tint * drawn.tints[name] for name, tint in tints.items()}
    return replace(start, tints=tints, devices=drawn.devices, look=drawn.look, lamps=drawn.light)


def _postured(
    task: "Task", qpos: NDArray[np.float64], by_rad: NDArray[np.float64], poses: Mapping[str, Matrix]
) -> NDArray[np.float64]:
    """Start qpos (N, D) displaced by `by_rad` (N, dof), or less where an arm would meet an object or an arm.

    An arm that meets an object even at rest, as bases or the table have moved, is retracted step by step.
    """
    for part in (1.0, 0.5, 0.25, 0.0):
        found = qpos.copy()
        for row, robot, off in zip(found, task.robots, by_rad, strict=True):
            arm = row[: robot.model.dof]
            arm[:] = (arm + part * off[: robot.model.dof]).clip(*robot.model.planned_rad)
        if not by_rad.any():
            return found
        if not (within := stands_in(task, found, poses)) and not arms_meet(task, found):
            return found
    for part in _DRAWN_IN:
        for k in within:
            robot = task.robots[k]
            arm, dof = found[k], robot.model.dof
            arm[:dof] = qpos[k, :dof] + part * (np.array(robot.model.aside_rad) - qpos[k, :dof])
        if not (within := stands_in(task, found, poses)):
            break
    return found


def stands_in(task: "Task", qpos: NDArray[np.float64], poses: Mapping[str, Matrix]) -> dict[int, str]:
    """Row of an arm at qpos (N, D) -> an object of `poses` nearer than CLEAR_M; only arms that have one."""
    pieces = [(name, pose, hull) for name, pose in poses.items() for hull in task.asset(name).hulls]
    found: dict[int, str] = {}
    for row, links in enumerate(_links(task, qpos)):
        near = (
            name
            for link, link_hull in links
            for name, pose, hull in pieces
            if _near(link_hull, hull, inverse(link) @ pose, CLEAR_M)
        )
        if (name := next(near, None)) is not None:
            found[row] = name
    return found


def arms_meet(task: "Task", qpos: NDArray[np.float64]) -> bool:
    """Whether any two arms at qpos (N, D) are nearer than APART_M."""
    return any(
        _near(hull, other_hull, inverse(link) @ other, APART_M)
        for a, b in combinations(_links(task, qpos), 2)
        for link, hull in a
        for other, other_hull in b
    )


def _links(task: "Task", qpos: NDArray[np.float64]) -> list[list[tuple[Matrix, "trimesh.Trimesh"]]]:
    """For each arm at qpos (N, D), the links as (world_from_link, convex hull)."""
    found = []
    for row, arm in zip(qpos, task.arms.values(), strict=True):
        links = dict(zip(arm.robot.links, arm.links(row[None])[0], strict=True))
        found.append([(links[link], hull) for link, hull in arm.robot.hulls.items()])
    return found


def _near(one: "trimesh.Trimesh", other: "trimesh.Trimesh", one_from_other: Matrix, least_m: float) -> bool:
    """Whether two convex meshes are nearer than `least_m`, by the vertices of each against the other's faces.

    An approximation that suffices as links and objects have many vertices.
    """
    between = apply(one_from_other, other.bounds.mean(axis=0)) - one.bounds.mean(axis=0)
    radii_m = (np.linalg.norm(one.extents) + np.linalg.norm(other.extents)) / 2
    if np.linalg.norm(between) > radii_m + least_m:
        return False
    return _within(one, apply(one_from_other, other.vertices), least_m) or _within(
        other, apply(inverse(one_from_other), one.vertices), least_m
    )


def _within(hull: "trimesh.Trimesh", points: NDArray[np.float64], least_m: float) -> bool:
    """Whether any point (K, 3) is inside a convex mesh or nearer than `least_m` to it."""
    outside_m = points @ hull.face_normals.T - (hull.triangles_center * hull.face_normals).sum(axis=1)
    return bool((outside_m.max(axis=1) < least_m).any())


def _drawn(task: "Task", rng: np.random.Generator) -> dict[str, Matrix]:
    poses: dict[str, Matrix] = {}
    for name, spec in task.objects.items():
        x_m, y_m, yaw_deg = (rng.uniform(*ends) for ends in (spec.x_m, spec.y_m, spec.yaw_deg))
        local = planar(x_m, y_m, np.deg2rad(yaw_deg), spec.z_m)
        if (hinge := task.asset(name).hinge) is not None:
            local = local @ hinge.turned(np.deg2rad(spec.open_deg))
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
    turns_rad = np.deg2rad(np.linspace(low_deg, high_deg, 1 + int(np.ceil(high_deg - low_deg))))
    upright = _footprint(task, name, planar(0.0, 0.0, 0.0))
    corners = np.array([(x, y, 0.0) for x in spec.x_m for y in spec.y_m])
    farthest = corners + np.linalg.norm(upright[:, :2], axis=1).max() * np.array([[[1.0]], [[-1.0]]])
    if (beyond := beyond_edge(farthest.reshape(-1, 3)))[0] <= 0:  # at any yaw
        return beyond
    turned = [upright @ planar(0.0, 0.0, turn)[:3, :3].T + at for turn in turns_rad for at in corners]
    return beyond_edge(np.concatenate(turned))


def _footprint(task: "Task", name: str, pose: Matrix) -> NDArray[np.float64]:
    """(K, 3) points that must be over the table: all vertices, or the origin of a mark or stacked object."""
    stands = task.asset(name).hulls and not task.objects[name].z_m
    return task.asset(name).vertices(pose) if stands else pose[None, :3, 3]


def _crowded(task: "Task", poses: Mapping[str, Matrix]) -> str | None:
    """Two objects that are too close on the table, seen from above, in words. Leaves out stacked objects."""
    outlines = {
        name: MultiPoint(task.asset(name).vertices(pose)[:, :2]).convex_hull
        for name, pose in poses.items()
        if task.asset(name).hulls and not task.objects[name].z_m
    }
    for a, b in combinations(outlines, 2):
        apart_m = outlines[a].distance(outlines[b])
        if apart_m <= 0:
            return f"{a} and {b} overlap by {1000 * _depth_m(outlines[a], outlines[b]):.0f} mm"
        if apart_m <= GAP_M:
            return f"{a} and {b} are {1000 * apart_m:.1f} mm apart"
    return None


def _depth_m(a: BaseGeometry, b: BaseGeometry) -> float:
    """Penetration depth of two overlapping convex outlines: the shortest move that separates them."""
    corners = [np.array(each.exterior.coords) for each in (a, b) if isinstance(each, Polygon)]
    edges = np.concatenate([np.diff(each, axis=0) for each in corners])
    normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    one, other = (each @ normals.T for each in corners)  # (K, E) along each normal
    ahead, behind = one.max(axis=0) - other.min(axis=0), other.max(axis=0) - one.min(axis=0)
    return float(np.minimum(ahead, behind).min())
