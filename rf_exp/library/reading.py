"""Task from a third-party scene: arms, objects and places, without success criteria.

The frame of a body is on its underside. Interaction points are derived from its shape and its orientation: a
grasp from above across the narrow side, and a flat top as a place. Other interactions need points given by
the user, which take precedence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from shapely import MultiPoint, Point, get_coordinates

from rf_exp.tasks import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Task
from rf_exp.tasks.assets import Asset, InteractionPoint, Part
from rf_exp.transforms import Matrix, apply, from_axes, inverse, transform
from rf_exp.types import Scene

MAX_GRASP_WIDTH_M = 0.075  # graspable width: opening of the fingers less a margin
PALM_CLEARANCE_M = 0.03  # largest height of an object above the TCP, below the palm
GRASP_HEIGHT = 0.45  # height of the grasp, relative to the object, where the palm leaves room
TIP_DEG = 30.0  # largest tilt of the gripper; the planner rejects contacts with the table
SQUARE_TOLERANCE_M = 0.002  # sides that differ by less are equal
FLAT_TOLERANCE_M = 0.001  # tolerance of a flat top
MIN_TOP_SHARE = 0.25  # smallest share of the outline from above that counts as a top
GREY = (0.5, 0.5, 0.5)
MARK_M = 0.005  # radius of the mark for a body without collision shapes

Solids = Sequence[trimesh.Trimesh]


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadRobot(RobotSpec):
    """An arm at an arbitrary base pose."""

    pose: Matrix  # world_from_base (4, 4)
    on_hand: Asset | None  # mounted on the hand, such as a camera; in the frame of the hand link

    @property
    def world_from_base(self) -> Matrix:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.pose

    @property
    def mounted(self) -> Asset | None:
        return self.on_hand


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadTask(Task):
    """Task of a third-party scene. Success is decided by its environment."""

    assets: Mapping[str, Asset]
    spots: Mapping[str, Matrix]  # named places: world_from_object (4, 4) of objects placed there

    @staticmethod
    def of(
        name: str,
        robots: tuple[ReadRobot, ...],
        assets: Mapping[str, Asset],
        spots: Mapping[str, Matrix],
        below: Mapping[str, str],
    ) -> "ReadTask":
        """`below`: object -> the object on which it stands."""
        return ReadTask(
            name,
            title=name,
            description=name,
            target_condition="",
            robots=robots,
            objects={
                object_name: ObjectSpec(asset.name, relative_to=below.get(object_name))
                for object_name, asset in assets.items()
            },
            # No viewpoint is defined, so sentences cannot name the left arm.
            cameras={
                camera: CameraSpec() for camera in ("global", *(f"agent{k + 1}" for k in range(len(robots))))
            },
            success={},
            randomisation=Randomisation(0.0, 0.0, 0.0, 0.0),  # scenes are randomised by the environment
            assets=assets,
            spots=spots,
        )

    def asset(self, name: str) -> Asset:
        return self.assets[name]

    def places(self, scene: Scene) -> Mapping[str, Matrix]:
        return self.spots

    @property
    def _sides(self) -> dict[str, int]:
        return {}


def upright_frame(solids: Solids, world_from_body: Matrix) -> Matrix:
    """body_from_object (4, 4): z up, origin in the middle of the underside, y along the narrow side.

    A body without shapes keeps its origin, with the axes of the world.
    """
    if not solids:
        return inverse(world_from_body) @ transform(world_from_body[:3, 3])
    corners = apply(world_from_body, _corners(solids))
    box = get_coordinates(MultiPoint(corners[:, :2]).minimum_rotated_rectangle)  # (5, 2), closed
    sides = np.diff(box[:3], axis=0)
    narrow = sides[int(np.argmin(np.linalg.norm(sides, axis=1)))]
    middle = (*box[:4].mean(axis=0), corners[:, 2].min())
    return inverse(world_from_body) @ from_axes(middle, z=(0, 0, 1), y=(*narrow, 0.0))


def asset_of(
    name: str, solids: Solids, body_from_object: Matrix, movable: bool, mass_kg: float,
    user_points: Mapping[str, InteractionPoint],
) -> Asset:  # fmt: skip
    """Asset of a body in its upright frame, with derived points and the user's, which take precedence."""
    object_from_body = inverse(body_from_object)
    hulls = [solid.copy().apply_transform(object_from_body) for solid in solids]
    mark = Part.sphere(MARK_M, transform(), GREY, solid=False)
    return Asset(
        name,
        parts=tuple(Part(hull, GREY) for hull in hulls) or (mark,),
        points={**_derived_points(hulls, movable), **user_points},
        mass_kg=mass_kg,
        static=not movable,
        visual_only=not hulls,
    )


def _derived_points(hulls: Solids, movable: bool) -> dict[str, InteractionPoint]:
    if not hulls:
        return {"middle": InteractionPoint(transform(), "place", turns=12)}
    corners = _corners(hulls)
    length_m, width_m, height_m = np.ptp(corners, axis=0)
    points = {}
    if movable and width_m <= MAX_GRASP_WIDTH_M:
        square = abs(length_m - width_m) < SQUARE_TOLERANCE_M
        grasp_height_m = max(GRASP_HEIGHT * height_m, height_m - PALM_CLEARANCE_M)
        points["center"] = InteractionPoint(
            from_axes((0, 0, grasp_height_m), z=(0, 0, -1), y=(0, 1, 0)),
            "grasp",
            width_m=float(width_m),
            turns=4 if square else 2,
            tip_deg=TIP_DEG,
        )
    if _flat_on_top(corners):
        points["top"] = InteractionPoint(transform((0, 0, height_m)), "place", turns=4)
    return points


def _flat_on_top(corners: NDArray[np.float64]) -> bool:
    """Whether the hull of the highest points contains the middle and is large enough to carry an object."""
    highest = corners[corners[:, 2] > corners[:, 2].max() - FLAT_TOLERANCE_M]
    top, outline = (MultiPoint(points[:, :2]).convex_hull for points in (highest, corners))
    return top.area >= MIN_TOP_SHARE * outline.area and top.intersects(Point(0.0, 0.0))


def _corners(solids: Solids) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(solid.vertices) for solid in solids])
