"""Laws of the procedural assets, and how the hand of a Panda fits them."""

import numpy as np
import pytest

from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets
from rf_exp.tasks.assets import Asset, InteractionPoint, lid, pot, steak
from rf_exp.transforms import apply, inverse, transform
from tests.conftest import read_task

# The hand around the TCP, from the collision shapes of the Panda's URDF; metres.
TIP_M = 0.0095  # finger tips beyond the TCP
PALM_M = 0.037  # the palm behind the TCP
PALM_HALF_M = (0.032, 0.105)  # half extents of the palm along the TCP's x and y
SPAN_M = 0.08  # between open fingers
CLEAR_M = 0.005

NAMES = assets.available()
GRASPS = [
    (name, point) for name in NAMES for point, at in assets.load(name).points.items() if at.kind == "grasp"
]


def inside(asset: Asset, points: np.ndarray) -> np.ndarray:
    """Which points (K, 3) lie within a solid part."""
    return np.any(
        [
            np.all(
                (points - hull.triangles_center[:, None]) @ hull.face_normals[..., None] < 1e-9, axis=(0, 2)
            )
            for hull in asset.hulls
        ],
        axis=0,
    )


def grasp(name: str, point: str) -> tuple[Asset, InteractionPoint, np.ndarray]:
    """Asset, point, and the vertices of the asset in the frame of the TCP."""
    asset = assets.load(name)
    at = asset.points[point]
    return asset, at, asset.vertices(inverse(at.object_from_tcp))


@pytest.mark.parametrize("name", NAMES)
def test_an_asset_is_made_of_convex_pieces_that_stand_on_the_table(name: str) -> None:
    asset = assets.load(name)
    assert asset.name == name and asset.mass_kg > 0 and asset.friction > 0
    for hull in asset.hulls:
        assert hull.is_watertight and hull.is_convex and hull.volume > 0
        assert len(hull.vertices) <= 255  # PhysX's limit for a convex mesh
    assert asset.bounds_m[0, 2] == pytest.approx(0, abs=1e-9)
    if asset.hulls:
        assert np.ptp(asset.vertices(np.eye(4)), axis=0).max() < 1.0


@pytest.mark.parametrize("name", NAMES)
def test_interaction_points_are_rigid_poses(name: str) -> None:
    for point in assets.load(name).points.values():
        rotation = point.object_from_tcp[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert point.kind in ("grasp", "press", "place") and point.standoff_m > 0


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_fingers_meet_the_asset_on_both_sides(name: str, point: str) -> None:
    asset, at, _ = grasp(name, point)
    assert at.width_m < SPAN_M - 2 * CLEAR_M
    for side in (-1, 1):
        line = np.array([[0, side * (at.width_m / 2 + gap), 0] for gap in (-0.002, 0.002)])
        assert inside(asset, apply(at.object_from_tcp, line)).tolist() == [True, False], side


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_finger_tips_clear_what_lies_below(name: str, point: str) -> None:
    asset, at, _ = grasp(name, point)
    tips = apply(at.object_from_tcp, np.array([[0, side * SPAN_M / 2, TIP_M] for side in (-1, 1)]))
    assert tips[:, 2].min() >= CLEAR_M  # the table
    around = np.array(
        [[0, side * SPAN_M / 2, depth] for side in (-1, 1) for depth in np.linspace(0, TIP_M + CLEAR_M, 6)]
    )
    assert not inside(asset, apply(at.object_from_tcp, around)).any()


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_palm_clears_what_stands_between_the_fingers(name: str, point: str) -> None:
    asset, at, _ = grasp(name, point)
    x, y = np.meshgrid(*(np.linspace(-half, half, 21) for half in PALM_HALF_M))
    depth = np.full(x.size, -PALM_M + CLEAR_M)
    assert not inside(asset, apply(at.object_from_tcp, np.column_stack([x.ravel(), y.ravel(), depth]))).any()


def test_the_barrier_is_gripped_where_the_release_grips_it() -> None:
    points = assets.load("barrier").points
    np.testing.assert_allclose(points["left"].object_from_tcp[:3, 3], [-0.222, 0, 0.074])
    np.testing.assert_allclose(points["right"].object_from_tcp[:3, 3], [0.222, 0, 0.074])
    np.testing.assert_allclose(points["left"].object_from_tcp[:3, 2], [0, 0, -1], atol=1e-12)


def test_the_lid_rests_on_the_rim_and_cannot_slide_off() -> None:
    free = pot.INNER_M * np.cos(np.pi / pot.WALLS)  # the opening is a polygon
    assert lid.PLUG_TOP_M < free < pot.OUTER_M
    on_pot = assets.load("lid").vertices(transform((0, 0, lid.SEAT_Z_M)))
    plug = on_pot[:, 2] < pot.HEIGHT_M - 1e-9
    assert plug.any() and np.hypot(*on_pot[plug, :2].T).max() < free
    assert read_task("place_food").objects["lid"].z_m == pytest.approx(lid.SEAT_Z_M)


def test_the_steak_fits_the_pot_in_the_hand() -> None:
    """It falls through the opening at any turn, and the palm stays above the rim when it is let go."""
    food, held = assets.load("steak"), assets.load("steak").points["center"].object_from_tcp[2, 3]
    free = pot.INNER_M * np.cos(np.pi / pot.WALLS)
    assert np.hypot(*food.vertices(np.eye(4))[:, :2].T).max() < free - 0.02
    fingers_m = SPAN_M / 2 + 0.026  # the widest part of an open finger
    assert np.hypot(fingers_m, 0.011) < free - CLEAR_M
    place = assets.load("pot").points["inside"]
    assert place.kind == "place"
    assert place.object_from_tcp[2, 3] + held + PALM_M > pot.HEIGHT_M + CLEAR_M
    assert place.object_from_tcp[2, 3] < pot.HEIGHT_M - steak.HEIGHT_M / 2


def test_an_unknown_asset_names_those_that_exist() -> None:
    with pytest.raises(ArgumentError) as error:
        assets.load("spoon")
    assert str(error.value) == f"unknown asset 'spoon'; available: {', '.join(sorted(NAMES))}"
