"""Assets and cameras of the authors' release in our tasks, with files in its layout from our own meshes."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.ablation.tables import inputs
from rf_exp.data.release import environment
from rf_exp.errors import ArgumentError
from rf_exp.tasks import ReleaseParts, assets, named_task, read_task
from rf_exp.tasks.assets.asset import annotated
from rf_exp.tasks.robofactory.release_parts import known_cameras
from tests.conftest import CONF, TASKS, experiment
from tests.tasks import release_assets as release_files

ALONE = ("barrier", "steak", "hammer", "shoe")  # assets of one file each; decomposed, or of convex pieces
SEATS_M = {"lid": 0.088, "box_lid": 0.086}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder_path = tmp_path_factory.mktemp("assets")
    for like in (*ALONE, "camera"):
        release_files.write(folder_path, like)
    release_files.write(folder_path, "box_lid", "box", SEATS_M["box_lid"])
    release_files.write(folder_path, "lid", "pot", SEATS_M["lid"])
    return folder_path


@pytest.mark.parametrize("like", [*ALONE, "camera"])
def test_an_asset_has_the_pose_size_and_points_of_its_files(like: str, folder: Path) -> None:
    released, own = annotated.build(str(folder), like), assets.load(like)
    assert np.allclose(released.bounds_m, own.bounds_m, atol=1e-4)
    assert released.points.keys() == own.points.keys() and released.mass_kg == own.mass_kg
    for name, point in own.points.items():
        assert np.allclose(released.points[name].object_from_tcp, point.object_from_tcp, atol=2e-4), name
        if point.kind == "grasp":
            assert released.points[name].width_m == pytest.approx(point.width_m, abs=2e-3)
    assert all(hull.is_convex for hull in released.hulls)
    assert released.content_digest != own.content_digest and released.name == f"{like}_of_release"


def test_a_lid_has_the_hinge_of_the_urdf(folder: Path) -> None:
    task = read_task(CONF / "task/three_robots_place_shoes.yaml", release_parts=release_parts(folder))
    assert task.objects["lid"].z_m == pytest.approx(SEATS_M["box_lid"], abs=1e-5)
    released, own = task.asset("lid"), assets.load("box_lid")
    assert released.hinge is not None and own.hinge is not None
    for axis in (1, 3):
        found, expected = (each.object_from_hinge[:3, axis] for each in (released.hinge, own.hinge))
        assert np.allclose(found, expected, atol=1e-4)
    assert task.asset("box").static and np.allclose(
        task.asset("box").bounds_m, assets.load("box").bounds_m, atol=1e-3
    )


def release_parts(folder: Path | None = None, cameras: bool = False) -> ReleaseParts:
    return ReleaseParts(
        "release" if folder else None, str(folder) if folder else None, "release" if cameras else None
    )


# -- in tasks ------------------------------------------------------------------------------------------


def test_parts_of_the_release_are_in_name_title_and_identity_of_a_task(folder: Path) -> None:
    path = CONF / "task/lift_barrier.yaml"
    original, borrowed = read_task(path), read_task(path, release_parts=release_parts(folder, cameras=True))
    assert borrowed.name == "lift_barrier+release_assets+release_cameras"
    assert borrowed.title == "Lift Barrier (assets and cameras of the release)"
    assert borrowed.module is original.module and borrowed.asset("barrier").name == "barrier_of_release"
    differs = {key for key, value in borrowed.identity.items() if value != original.identity[key]}
    assert differs == {"objects", "cameras"} and str(folder) not in str(borrowed.identity)
    cubes = CONF / "task/stack_cube.yaml"  # a task without assets of the release
    assert read_task(cubes, release_parts=release_parts(folder)) == read_task(cubes)


@pytest.mark.parametrize("name", TASKS)
def test_cameras_of_the_release_have_its_poses(name: str) -> None:
    task = named_task(f"{name}+release_cameras")
    assert task is not None
    for camera, expected in known_cameras()[name].items():
        assert task.cameras[camera].eye_m == tuple(expected["eye_m"])
        assert np.isfinite(task.cameras[camera].world_from_camera).all()
    assert named_task(f"{name}+release_assets") is None  # the folder is unknown


def test_camera_quaternions_are_in_the_sapien_frame() -> None:
    """SAPIEN: x forward, y left, z up; here: z forward, x right, y down."""
    task = named_task("take_photo+release_cameras")
    assert task is not None
    axes = Rotation.from_quat((0.42276, -0.258701, 0.127348, 0.859145), scalar_first=True).as_matrix().T
    x, y, z = task.cameras["global"].world_from_camera[:3, :3].T
    assert np.allclose((z, -x, -y), axes, atol=1e-6)


def test_tables_and_exports_name_the_parts_of_the_release() -> None:
    suite = inputs.facts([read_task(CONF / "task/lift_barrier.yaml")])
    name = "lift_barrier-ur5+release_assets+release_cameras"
    assert inputs.title_of(name, suite) == "Lift Barrier (ur5) (assets and cameras of the release)"
    assert inputs.agents_of(name, suite) == 2
    assert environment("lift_barrier+release_cameras") == "LiftBarrier-rf"


@pytest.mark.slow
def test_an_experiment_names_what_it_uses(folder: Path) -> None:
    chosen = f"assets_folder={folder}", "assets=release", "cameras_of=release", "robot=xarm7"
    (task,) = experiment("task=pick_meat", *chosen).tasks
    assert task.name == "pick_meat-xarm7+release_assets+release_cameras"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"assets": "mine", "assets_folder": "x"}, "unknown assets 'mine'; available: null, release"),
        ({"cameras_of": "ours"}, "unknown cameras_of 'ours'"),
        ({"assets": "release"}, "expected both, assets=release assets_folder=FOLDER"),
        ({"assets_folder": "x"}, "assets is None and assets_folder x"),
        (
            {"assets": "release", "assets_folder": "conf"},
            "has no folder objects; expected the folder `assets`",
        ),
    ],
)
def test_inconsistent_keys_are_refused(keys: dict[str, str], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        ReleaseParts(**keys)


def test_missing_parts_of_the_release_are_named(folder: Path) -> None:
    with pytest.raises(ArgumentError, match="the release has no cameras of 'lift'; it has some of pick_meat"):
        read_task(CONF / "task/family/lift.yaml", release_parts=release_parts(cameras=True))
    with pytest.raises(ArgumentError, match=r"object 'cup': there is no .*models\.json"):
        read_task(CONF / "task/place_cube_in_cup.yaml", release_parts=release_parts(folder))


# -- invalid files -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": [60, 60, 20]}, "the thing is 60 m long, and ours 0.6 m; expected 0.5 to 2 times"),
        ({"scale": 0.6}, "has no scale of three numbers above 0; its keys are scale, center"),
        ({"scale": None, "scales": [1, 1, 1]}, "its keys are scale, center, contact_points_pose"),
        (
            {"contact_points_pose": [np.eye(4).tolist()]},
            "lacks number 1 of contact_points_pose; has 1 of them",
        ),
        ({"contact_points_pose": None, "contacts": []}, "lacks number 1 .* its keys are scale, center"),
        ({"contact_points_pose": [[[1]]] * 3}, "number 1 of contact_points_pose is no pose"),
        ({"contact_points_pose": [np.diag([1, 1, 1, 1]).tolist()] * 3}, "'left'"),
    ],
)
def test_an_invalid_annotation_is_refused_with_its_key(changes: Any, message: str, tmp_path: Path) -> None:
    release_files.write(tmp_path, "barrier")
    path = tmp_path / "objects" / assets.release_sources()["barrier"].annotation
    annotation = json.loads(path.read_text())
    path.write_text(json.dumps({**annotation, **changes}))
    with pytest.raises(ArgumentError, match=message):
        rebuilt(tmp_path, "barrier")


def rebuilt(folder: Path, like: str) -> Any:
    """Builds an asset without the cache, as its files have changed."""
    annotated.shape_of.cache_clear()
    return annotated.build(str(folder), like)


def test_files_that_are_missing_or_broken_are_named(tmp_path: Path) -> None:
    release_files.write(tmp_path, "lid", "pot", SEATS_M["lid"])
    urdf = tmp_path / "objects" / assets.release_sources()["lid"].mesh
    valid_urdf = urdf.read_text()
    for text, message in (
        ("<robot", "URDF .* cannot be read"),
        ("<robot/>", "has no link that is moving and seen"),
        (valid_urdf.replace("moves.glb", "gone.glb"), "there is no mesh file .*gone.glb"),
        (valid_urdf.replace('<parent link="still"/>', ""), "<joint> has no <parent>"),
        (valid_urdf.replace('<parent link="base"/>', '<parent link="moves"/>'), "in a circle"),
    ):
        urdf.write_text(text)
        with pytest.raises(ArgumentError, match=message):
            rebuilt(tmp_path, "lid")
    urdf.unlink()
    with pytest.raises(ArgumentError, match=re.escape(f"there is no {urdf}")):
        rebuilt(tmp_path, "lid")
    (tmp_path / "objects" / assets.release_sources()["lid"].annotation).write_text("{")
    with pytest.raises(ArgumentError, match=r"annotation .*model_data.json cannot be read"):
        rebuilt(tmp_path, "lid")
