"""Properties of the procedural assets, and fit of the Panda gripper to them."""

from dataclasses import replace
from itertools import combinations

import coal
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError
from rf_exp.geometry import Piece
from rf_exp.geometry.swept import asset_pieces
from rf_exp.robots import DEFAULT
from rf_exp.sim import Simulator
from rf_exp.tasks import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Task, assets, default_of
from rf_exp.tasks.assets import Asset, InteractionPoint, camera, cup, lid, pot, steak
from rf_exp.tasks.predicates import tilt_deg
from rf_exp.transforms import Matrix, apply, inverse, transform
from tests.conftest import read_task

# The gripper around the TCP, from the collision shapes of the Panda's URDF; metres.
TIP_M = 0.0095  # finger tips in front of the TCP
PALM_M = 0.037  # the palm behind the TCP
PALM_HALF_M = (0.032, 0.105)  # half extents of the palm along the TCP's x and y
SPAN_M = 0.08  # distance of the open fingers
CLEAR_M = 0.005
MARGIN_M = 0.003  # clearance that planners keep between a gripper and objects that it may not touch

NAMES = assets.available()
GRASPS = [
    (name, point)
    for name in NAMES
    for point, contact in assets.load(name).points.items()
    if contact.kind == "grasp"
]


def inside(asset: Asset, points: np.ndarray) -> np.ndarray:
    """Mask of the points (K, 3) that lie within a solid part."""
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
    contact = asset.points[point]
    return asset, contact, asset.vertices(inverse(contact.object_from_tcp))


def gripper(world_from_tcp: Matrix, opening_m: float) -> list[tuple[Piece, Matrix]]:
    """Hand and fingers of a Panda, each finger `opening_m` from the middle, with their world poses."""
    qpos = np.concatenate([np.zeros(7), [opening_m, opening_m]])
    poses, tcp_from_base = DEFAULT.link_poses(qpos), inverse(DEFAULT.tcp_pose(qpos))
    names = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    return [
        (Piece.of(DEFAULT.hulls[name]), world_from_tcp @ tcp_from_base @ poses[DEFAULT.links.index(name)])
        for name in names
    ]


def gap_m(a: Piece, world_from_a: Matrix, b: Piece, world_from_b: Matrix) -> float:
    """Distance of two pieces; negative where they overlap."""
    placed = [coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (world_from_a, world_from_b)]
    return coal.distance(
        a.shape, placed[0], b.shape, placed[1], coal.DistanceRequest(), coal.DistanceResult()
    )


def gaps_m(gripper_links: list[tuple[Piece, Matrix]], asset: Asset, world_from_asset: Matrix) -> np.ndarray:
    """Distances (links, pieces of the asset)."""
    pieces = asset_pieces(asset)
    return np.array([[gap_m(*link, piece, world_from_asset) for piece in pieces] for link in gripper_links])


def about(axis: str, angle_deg: float) -> Matrix:
    return transform(rotation=Rotation.from_euler(axis, angle_deg, degrees=True))


@pytest.mark.parametrize("name", NAMES)
def test_an_asset_consists_of_convex_pieces_and_stands_on_the_table(name: str) -> None:
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
        assert point.kind in ("grasp", "press", "shut", "place", "drop", "tool") and point.standoff_m > 0


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_fingers_meet_the_asset_on_both_sides(name: str, point: str) -> None:
    asset, contact, _ = grasp(name, point)
    assert contact.width_m < SPAN_M - 2 * CLEAR_M
    for side in (-1, 1):
        line = np.array([[0, side * (contact.width_m / 2 + gap), 0] for gap in (-0.002, 0.002)])
        assert inside(asset, apply(contact.object_from_tcp, line)).tolist() == [True, False], side


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_finger_tips_are_clear_of_the_table_and_the_asset(name: str, point: str) -> None:
    asset, contact, _ = grasp(name, point)
    tips = apply(contact.object_from_tcp, np.array([[0, side * SPAN_M / 2, TIP_M] for side in (-1, 1)]))
    assert tips[:, 2].min() >= CLEAR_M  # the table
    around = np.array(
        [[0, side * SPAN_M / 2, depth] for side in (-1, 1) for depth in np.linspace(0, TIP_M + CLEAR_M, 6)]
    )
    assert not inside(asset, apply(contact.object_from_tcp, around)).any()


@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_palm_is_clear_of_the_asset_between_the_fingers(name: str, point: str) -> None:
    asset, contact, _ = grasp(name, point)
    x, y = np.meshgrid(*(np.linspace(-half, half, 21) for half in PALM_HALF_M))
    depth = np.full(x.size, -PALM_M + CLEAR_M)
    assert not inside(
        asset, apply(contact.object_from_tcp, np.column_stack([x.ravel(), y.ravel(), depth]))
    ).any()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "point"), GRASPS)
def test_the_open_gripper_approaches_and_retreats_without_contact_turned_and_tipped(
    name: str, point: str
) -> None:
    asset, contact, _ = grasp(name, point)
    for turn in range(contact.turns):
        for tip_deg in {-contact.tip_deg, 0.0, contact.tip_deg}:
            turned = contact.object_from_tcp @ about("z", 360 / contact.turns * turn) @ about("y", tip_deg)
            for back_m in (0.0, 0.01, contact.standoff_m):
                gripper_links = gripper(turned @ transform((0, 0, -back_m)), SPAN_M / 2)
                assert gaps_m(gripper_links, asset, np.eye(4)).min() > MARGIN_M
                assert (
                    min(apply(pose, piece.vertices)[:, 2].min() for piece, pose in gripper_links) > MARGIN_M
                )


@pytest.mark.parametrize("name", NAMES)
def test_grasp_points_are_above_the_centre_of_mass(name: str) -> None:
    asset = assets.load(name)
    grips = [contact.object_from_tcp[:2, 3] for contact in asset.points.values() if contact.kind == "grasp"]
    if grips:
        volumes = np.array([hull.volume for hull in asset.hulls])
        middle = np.average([hull.center_mass for hull in asset.hulls], axis=0, weights=volumes)
        np.testing.assert_allclose(np.mean(grips, axis=0), middle[:2], atol=CLEAR_M)


@pytest.mark.parametrize("turn", range(8))
def test_closed_fingers_press_the_shutter_and_nothing_else(turn: int) -> None:
    asset = assets.load("camera")
    contact = asset.points["shutter"]
    assert contact.kind == "press" and contact.turns == 8
    closed = gripper(contact.object_from_tcp @ about("z", 45 * turn), 0.0)
    gaps = gaps_m(closed, asset, np.eye(4))
    tops = np.array([hull.bounds[1, 2] for hull in asset.hulls])
    button = tops == tops.max()
    assert button.sum() == 1 and tops.max() == pytest.approx(camera.TOP_M + camera.BUTTON_M)
    assert gaps[:, ~button].min() > MARGIN_M and gaps[0].min() > MARGIN_M
    assert (gaps[1:, button] > -camera.BUTTON_M).all() and (gaps[1:, button] < -0.0005).all()


def test_three_grippers_fit_round_the_camera_on_its_plinth() -> None:
    points = assets.load("camera").points
    below = transform((0, 0, -assets.load("plinth").points["top"].object_from_tcp[2, 3]))
    grippers = [gripper(points[name].object_from_tcp, SPAN_M / 2) for name in ("left", "right")]
    for gripper_links in grippers:
        assert gaps_m(gripper_links, assets.load("plinth"), below).min() > 0.02
    grippers.append(gripper(points["shutter"].object_from_tcp, 0.0))
    for one, other in combinations(grippers, 2):
        assert min(gap_m(*a, *b) for a in one for b in other) > 0.03


def test_the_camera_points_along_its_lens_and_the_hammer_strikes_downwards() -> None:
    lens, head = assets.load("camera").points["lens"], assets.load("hammer").points["head"]
    assert lens.kind == head.kind == "tool"
    np.testing.assert_allclose(lens.object_from_tcp[:3, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(head.object_from_tcp[:3, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(head.object_from_tcp[:3, 3], [-0.02, 0, 0], atol=1e-12)
    assert assets.load("hammer").bounds_m[1, 0] <= 0  # scenes place it behind a line


@pytest.mark.parametrize("name", NAMES)
def test_an_asset_stands_on_a_wide_foot(name: str) -> None:
    asset = assets.load(name)
    if asset.hulls:
        vertices = asset.vertices(np.eye(4))
        foot = ConvexHull(vertices[vertices[:, 2] < 1e-6, :2])
        volumes = np.array([hull.volume for hull in asset.hulls])
        middle = np.average([hull.center_mass for hull in asset.hulls], axis=0, weights=volumes)
        assert (foot.equations @ [*middle[:2], 1]).max() < -CLEAR_M


@pytest.mark.slow
def test_assets_stay_where_they_are_dropped() -> None:
    """Dropped from 3 mm, all assets are upright and at rest within two seconds, the camera on its plinth."""
    built = {name: assets.load(name) for name in NAMES}
    # Hinged assets have no independent position.
    movable = [
        name for name, asset in built.items() if not (asset.static or asset.visual_only or asset.hinge)
    ]
    heights_m = {name: 0.003 for name in movable} | {"camera": 0.123}
    positions_m = {name: (0.9 * (k % 3) - 0.6, 0.5 * (k // 3) - 0.9) for k, name in enumerate(movable)}
    objects = {
        name: ObjectSpec(name, (x, x), (y, y), heights_m[name], (30.0, 30.0))
        for name, (x, y) in positions_m.items()
    }
    x, y = positions_m["camera"]
    objects["plinth"] = ObjectSpec("plinth", (x, x), (y, y), 0.0, (30.0, 30.0))
    cameras, randomisation = (
        {"global": CameraSpec(), "agent1": CameraSpec()},
        Randomisation(**default_of("randomisation")),
    )
    task = Task("drop", "", "", "", (RobotSpec(-1.0, 1.2, 0.0),), objects, cameras, {}, randomisation)
    with Simulator(task, render=False) as simulator:
        start = simulator.reset(0)
        for _ in range(40):
            scene = simulator.step(simulator.command)
    for name in movable:
        moved = scene.poses[name][:3, 3] - start.poses[name][:3, 3]
        assert np.linalg.norm(moved[:2]) < 0.002 and -0.005 < moved[2] < 0, name
        assert tilt_deg(scene.poses[name]) < 0.5, name
        assert scene.speeds[name] < 0.005, name


def test_a_cube_has_three_colours_and_sizes_that_fit_the_gripper() -> None:
    cubes = {colour: assets.load("cube", {"colour": colour}) for colour in ("blue", "red", "green")}
    assert len({cube.parts[1].colour for cube in cubes.values()}) == 3
    small = assets.load("cube", {"half_m": 0.015})
    assert small.points["top"].object_from_tcp[2, 3] == pytest.approx(0.03)
    with pytest.raises(ArgumentError, match=r"'pink'; available: blue, green, red"):
        assets.load("cube", {"colour": "pink"})
    with pytest.raises(ArgumentError, match=r"half_m=0\.05 of a cube; expected"):
        assets.load("cube", {"half_m": 0.05})
    with pytest.raises(ArgumentError, match="sheen"):
        assets.load("cube", {"sheen": 1.0})


def test_the_grasp_points_of_the_barrier_are_those_of_the_release() -> None:
    points = assets.load("barrier").points
    np.testing.assert_allclose(points["left"].object_from_tcp[:3, 3], [-0.222, 0, 0.074])
    np.testing.assert_allclose(points["right"].object_from_tcp[:3, 3], [0.222, 0, 0.074])
    np.testing.assert_allclose(points["left"].object_from_tcp[:3, 2], [0, 0, -1], atol=1e-12)


def test_the_lid_rests_on_the_rim_and_cannot_slide_off() -> None:
    opening_m = pot.INNER_M * np.cos(np.pi / pot.WALLS)  # the opening is a polygon
    assert lid.PLUG_TOP_M < opening_m < pot.OUTER_M
    on_pot = assets.load("lid").vertices(transform((0, 0, lid.SEAT_Z_M)))
    plug = on_pot[:, 2] < pot.HEIGHT_M - 1e-9
    assert plug.any() and np.hypot(*on_pot[plug, :2].T).max() < opening_m
    assert read_task("place_food").objects["lid"].z_m == pytest.approx(lid.SEAT_Z_M)


def test_the_steak_fits_the_pot_with_its_gripper() -> None:
    """The steak fits through the opening at any rotation, and the palm stays above the rim at its release."""
    steak_asset, held = assets.load("steak"), assets.load("steak").points["center"].object_from_tcp[2, 3]
    opening_m = pot.INNER_M * np.cos(np.pi / pot.WALLS)
    assert np.hypot(*steak_asset.vertices(np.eye(4))[:, :2].T).max() < opening_m - 0.02
    fingers_m = SPAN_M / 2 + 0.026  # the widest part of an open finger
    assert np.hypot(fingers_m, 0.011) < opening_m - CLEAR_M
    place = assets.load("pot").points["inside"]
    assert place.kind == "drop"
    assert place.object_from_tcp[2, 3] + held + PALM_M > pot.HEIGHT_M + CLEAR_M
    assert place.object_from_tcp[2, 3] < pot.HEIGHT_M - steak.HEIGHT_M / 2


def test_the_stem_of_a_cup_is_held_from_all_sides_and_a_cube_falls_in() -> None:
    asset = assets.load("cup")
    stem = asset.points["stem"]
    assert len(stem.equivalent_poses) == stem.around == cup.AROUND
    np.testing.assert_allclose(stem.equivalent_poses[0], stem.object_from_tcp)
    towards = np.array([pose[:3, 2] for pose in stem.equivalent_poses])
    np.testing.assert_allclose(towards[:, 2], 0, atol=1e-12)
    directions = np.unwrap(np.arctan2(towards[:, 1], towards[:, 0]))
    np.testing.assert_allclose(np.diff(directions), 2 * np.pi / cup.AROUND)
    for pose in stem.equivalent_poses:
        gripper_links = gripper(pose, SPAN_M / 2)
        assert gaps_m(gripper_links, asset, np.eye(4)).min() > MARGIN_M
        assert (
            min(apply(link_pose, piece.vertices)[:, 2].min() for piece, link_pose in gripper_links) > MARGIN_M
        )
    cube = assets.load("cube").vertices(np.eye(4))
    largest_m, smallest_m = 1.15 * np.hypot(*cube[:, :2].T).max(), 0.85 * cup.INNER_M
    assert largest_m + 0.004 < smallest_m * np.cos(np.pi / cup.WALLS)  # for all randomised sizes
    tips_m = assets.load("cube").points["center"].object_from_tcp[2, 3] - TIP_M
    assert asset.points["inside"].object_from_tcp[2, 3] + tips_m > cup.RIM_M + 2 * CLEAR_M


def test_symmetry_changes_the_digest_only_where_there_is_one() -> None:
    """The digest of an asset contains its rotational symmetry only where it has one."""
    plain = assets.load("cube")
    assert all(len(point.equivalent_poses) == 1 for point in plain.points.values())
    points = {name: replace(point, around=4) for name, point in plain.points.items()}
    assert replace(plain, points=points).content_digest != plain.content_digest


def test_an_unknown_asset_names_those_that_exist() -> None:
    with pytest.raises(ArgumentError) as error:
        assets.load("spoon")
    assert str(error.value) == f"unknown asset 'spoon'; available: {', '.join(sorted(NAMES))}"
