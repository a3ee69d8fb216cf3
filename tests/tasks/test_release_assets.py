"""Assets and cameras of the authors' release in our tasks: files by its layout, made of our own meshes."""

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
from tests.tasks import release_assets as theirs

ALONE = ("barrier", "steak", "hammer", "shoe")  # one file each; hulls, and pieces that are convex
SEATS_M = {"lid": 0.088, "box_lid": 0.086}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("assets")
    for like in (*ALONE, "camera"):
        theirs.write(made, like)
    theirs.write(made, "box_lid", "box", SEATS_M["box_lid"])
    theirs.write(made, "lid", "pot", SEATS_M["lid"])
    return made


@pytest.mark.parametrize("like", [*ALONE, "camera"])
def test_an_asset_stands_is_as_large_and_is_acted_on_as_its_files_say(like: str, folder: Path) -> None:
    made, ours = annotated.build(str(folder), like), assets.load(like)
    assert np.allclose(made.bounds_m, ours.bounds_m, atol=1e-4)
    assert made.points.keys() == ours.points.keys() and made.mass_kg == ours.mass_kg
    for name, point in ours.points.items():
        assert np.allclose(made.points[name].object_from_tcp, point.object_from_tcp, atol=2e-4), name
        if point.kind == "grasp":
            assert made.points[name].width_m == pytest.approx(point.width_m, abs=2e-3)
    assert all(hull.is_convex for hull in made.hulls)
    assert made.content_digest != ours.content_digest and made.name == f"{like}_of_release"


def test_a_lid_hangs_on_its_box_where_the_urdf_says(folder: Path) -> None:
    task = read_task(CONF / "task/three_robots_place_shoes.yaml", release_parts=release_parts(folder))
    assert task.objects["lid"].z_m == pytest.approx(SEATS_M["box_lid"], abs=1e-5)
    made, ours = task.asset("lid"), assets.load("box_lid")
    assert made.hinge is not None and ours.hinge is not None
    for axis in (1, 3):
        found, expected = (each.object_from_hinge[:3, axis] for each in (made.hinge, ours.hinge))
        assert np.allclose(found, expected, atol=1e-4)
    assert task.asset("box").static and np.allclose(
        task.asset("box").bounds_m, assets.load("box").bounds_m, atol=1e-3
    )


def release_parts(folder: Path | None = None, cameras: bool = False) -> ReleaseParts:
    return ReleaseParts(
        "release" if folder else None, str(folder) if folder else None, "release" if cameras else None
    )


# -- in tasks ------------------------------------------------------------------------------------------


def test_what_a_task_has_of_the_release_is_in_its_name_title_and_identity(folder: Path) -> None:
    path = CONF / "task/lift_barrier.yaml"
    usual, both = read_task(path), read_task(path, release_parts=release_parts(folder, cameras=True))
    assert both.name == "lift_barrier+release_assets+release_cameras"
    assert both.title == "Lift Barrier (assets and cameras of the release)"
    assert both.module is usual.module and both.asset("barrier").name == "barrier_of_release"
    differs = {key for key, value in both.identity.items() if value != usual.identity[key]}
    assert differs == {"objects", "cameras"} and str(folder) not in str(both.identity)
    cubes = CONF / "task/stack_cube.yaml"  # of which the release has nothing but what is ours too
    assert read_task(cubes, release_parts=release_parts(folder)) == read_task(cubes)


@pytest.mark.parametrize("name", TASKS)
def test_cameras_of_the_release_look_where_it_says(name: str) -> None:
    task = named_task(f"{name}+release_cameras")
    assert task is not None
    for camera, said in known_cameras()[name].items():
        assert task.cameras[camera].eye_m == tuple(said["eye_m"])
        assert np.isfinite(task.cameras[camera].world_from_camera).all()
    assert named_task(f"{name}+release_assets") is None  # nobody knows where they lie


def test_a_quaternion_of_a_camera_is_of_sapiens_frame() -> None:
    """x forward, y left, z up: here z forward, x right, y down."""
    task = named_task("take_photo+release_cameras")
    assert task is not None
    axes = Rotation.from_quat((0.42276, -0.258701, 0.127348, 0.859145), scalar_first=True).as_matrix().T
    x, y, z = task.cameras["global"].world_from_camera[:3, :3].T
    assert np.allclose((z, -x, -y), axes, atol=1e-6)


def test_tables_and_exports_tell_what_was_borrowed() -> None:
    suite = inputs.facts([read_task(CONF / "task/lift_barrier.yaml")])
    called = "lift_barrier-ur5+release_assets+release_cameras"
    assert inputs.title_of(called, suite) == "Lift Barrier (ur5) (assets and cameras of the release)"
    assert inputs.agents_of(called, suite) == 2
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
def test_keys_that_do_not_go_together_are_refused(keys: dict[str, str], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        ReleaseParts(**keys)


def test_what_the_release_or_a_folder_does_not_have_is_named(folder: Path) -> None:
    with pytest.raises(ArgumentError, match="the release has no cameras of 'lift'; it has some of pick_meat"):
        read_task(CONF / "task/family/lift.yaml", release_parts=release_parts(cameras=True))
    with pytest.raises(ArgumentError, match=r"object 'cup': there is no .*models\.json"):
        read_task(CONF / "task/place_cube_in_cup.yaml", release_parts=release_parts(folder))


# -- files that are not as the release's ---------------------------------------------------------------


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
def test_an_annotation_that_is_another_is_refused_by_its_key(
    changes: Any, message: str, tmp_path: Path
) -> None:
    theirs.write(tmp_path, "barrier")
    path = tmp_path / "objects" / assets.release_sources()["barrier"].annotation
    said = json.loads(path.read_text())
    path.write_text(json.dumps({**said, **changes}))
    with pytest.raises(ArgumentError, match=message):
        fresh(tmp_path, "barrier")


def fresh(folder: Path, like: str) -> Any:
    """Built anew: files have changed."""
    annotated.shape_of.cache_clear()
    return annotated.build(str(folder), like)


def test_files_that_are_missing_or_broken_are_named(tmp_path: Path) -> None:
    theirs.write(tmp_path, "lid", "pot", SEATS_M["lid"])
    urdf = tmp_path / "objects" / assets.release_sources()["lid"].mesh
    usual = urdf.read_text()
    for text, message in (
        ("<robot", "URDF .* cannot be read"),
        ("<robot/>", "has no link that is moving and seen"),
        (usual.replace("moves.glb", "gone.glb"), "there is no mesh file .*gone.glb"),
        (usual.replace('<parent link="still"/>', ""), "<joint> has no <parent>"),
        (usual.replace('<parent link="base"/>', '<parent link="moves"/>'), "in a circle"),
    ):
        urdf.write_text(text)
        with pytest.raises(ArgumentError, match=message):
            fresh(tmp_path, "lid")
    urdf.unlink()
    with pytest.raises(ArgumentError, match=re.escape(f"there is no {urdf}")):
        fresh(tmp_path, "lid")
    (tmp_path / "objects" / assets.release_sources()["lid"].annotation).write_text("{")
    with pytest.raises(ArgumentError, match=r"annotation .*model_data.json cannot be read"):
        fresh(tmp_path, "lid")
