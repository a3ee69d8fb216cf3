"""A scene that was read, as the rest of the suite knows tasks: arms, objects and places, and no criteria.

A body has a frame on its underside, and points where it can be taken and built upon, derived from its shape
and from how it stands where nobody has annotated it: a grasp from above across its narrow side, a flat top as
a place. What should be met otherwise wants points of its own.
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

WIDEST_M = 0.075  # between open fingers, with a little to spare
PALM_M = 0.03  # of a thing that may stand out above the tool centre point, below the palm
GRIP = 0.45  # of the height of a thing: where it is taken, if the palm is not in the way
TIP_DEG = 30.0  # that a gripper may be tipped; what touches the table then is found by the planner
SQUARE_M = 0.002  # sides that differ by less are equal
FLAT_M = 0.001  # of a top
FLAT_SHARE = 0.25  # of the outline from above, that a top has at least
GREY = (0.5, 0.5, 0.5)
MARK_M = 0.005  # radius of what stands for a body without a shape

Solids = Sequence[trimesh.Trimesh]


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadRobot(RobotSpec):
    """An arm that stands anywhere, in any way."""

    pose: Matrix  # world_from_base (4, 4)
    on_hand: Asset | None  # a camera, say; in the frame of its link

    @property
    def world_from_base(self) -> Matrix:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.pose

    @property
    def mounted(self) -> Asset | None:
        return self.on_hand


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadTask(Task):
    """A scene with what can be said of it. When it is solved, its environment knows."""

    assets: Mapping[str, Asset]
    spots: Mapping[str, Matrix]  # named places: world_from_object (4, 4) of what is put there

    @staticmethod
    def of(
        name: str,
        robots: tuple[ReadRobot, ...],
        assets: Mapping[str, Asset],
        spots: Mapping[str, Matrix],
        below: Mapping[str, str],
    ) -> "ReadTask":
        """`below` names, for what stands on another object, that object."""
        return ReadTask(
            name,
            title=name,
            description=name,
            target_condition="",
            robots=robots,
            objects={
                each: ObjectSpec(asset.name, relative_to=below.get(each)) for each, asset in assets.items()
            },
            # Nobody looks on: sentences cannot speak of the left arm.
            cameras={
                camera: CameraSpec() for camera in ("global", *(f"agent{k + 1}" for k in range(len(robots))))
            },
            success={},
            randomisation=Randomisation(0.0, 0.0, 0.0, 0.0),  # its environment draws the scenes
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
    """body_from_object (4, 4): z up, origin on the underside in the middle, y along the narrow side.

    Of a body without a shape the origin stays where it is.
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
    given: Mapping[str, InteractionPoint],
) -> Asset:  # fmt: skip
    """The body in its upright frame, with what is derived and what is given of its points."""
    object_from_body = inverse(body_from_object)
    hulls = [solid.copy().apply_transform(object_from_body) for solid in solids]
    mark = Part.sphere(MARK_M, transform(), GREY, solid=False)
    return Asset(
        name,
        parts=tuple(Part(hull, GREY) for hull in hulls) or (mark,),
        points={**_derived(hulls, movable), **given},
        mass_kg=mass_kg,
        static=not movable,
        ghost=not hulls,
    )


def _derived(hulls: Solids, movable: bool) -> dict[str, InteractionPoint]:
    if not hulls:
        return {"middle": InteractionPoint(transform(), "place", turns=12)}
    corners = _corners(hulls)
    length_m, width_m, height_m = np.ptp(corners, axis=0)
    found = {}
    if movable and width_m <= WIDEST_M:
        square = abs(length_m - width_m) < SQUARE_M
        grip_m = max(GRIP * height_m, height_m - PALM_M)
        found["center"] = InteractionPoint(
            from_axes((0, 0, grip_m), z=(0, 0, -1), y=(0, 1, 0)),
            "grasp",
            width_m=float(width_m),
            turns=4 if square else 2,
            tip_deg=TIP_DEG,
        )
    if _flat_on_top(corners):
        found["top"] = InteractionPoint(transform((0, 0, height_m)), "place", turns=4)
    return found


def _flat_on_top(corners: NDArray[np.float64]) -> bool:
    """Whether the highest points lie round the middle, and far enough apart to carry something."""
    highest = corners[corners[:, 2] > corners[:, 2].max() - FLAT_M]
    top, outline = (MultiPoint(each[:, :2]).convex_hull for each in (highest, corners))
    return top.area >= FLAT_SHARE * outline.area and top.intersects(Point(0.0, 0.0))


def _corners(solids: Solids) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(solid.vertices) for solid in solids])
