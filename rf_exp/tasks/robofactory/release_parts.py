"""Assets and cameras of the authors' release in our tasks: `assets=release`, `cameras_of=release`.

The borrowed parts are part of the task's name, `lift_barrier+release_assets+release_cameras`, and so of
folders, rows and tables; without any the name is unchanged. Everything else is the task's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.tasks import assets
from rf_exp.tasks.task.specs import CameraSpec
from rf_exp.transforms import inverse, transform

RELEASE = "release"
MARK_SEPARATOR = "+"  # in names, between a task and its borrowed parts
RELEASE_ASSETS, RELEASE_CAMERAS = "release_assets", "release_cameras"
SAPIEN_FROM_OPENCV = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # rotation of camera axes
RELEASE_MODULE = "rf_exp.tasks.assets.asset.annotated"


@dataclass(frozen=True)
class ReleaseParts:
    """Parts that tasks borrow from the release. Raises ArgumentError for inconsistent keys."""

    assets: str | None = None  # release
    assets_folder: str | None = None
    cameras_of: str | None = None  # release

    def __post_init__(self) -> None:
        for key in ("assets", "cameras_of"):
            if (value := getattr(self, key)) not in (None, RELEASE):
                raise unknown_choice(key, value, (RELEASE, "null"))
        if (self.assets is None) != (self.assets_folder is None):
            raise ArgumentError(
                f"assets is {self.assets} and assets_folder {self.assets_folder}; expected both, "
                "assets=release assets_folder=FOLDER, or neither"
            )
        if self.assets_folder is not None and not (Path(self.assets_folder) / "objects").is_dir():
            raise ArgumentError(
                f"assets_folder is {self.assets_folder}, which has no folder objects; expected the folder "
                "`assets` of the release"
            )


def with_release(
    name: str, node: Mapping[str, Any], release_parts: ReleaseParts
) -> tuple[str, Mapping[str, Any]]:
    """Name and configuration of a task with its borrowed parts.

    Raises ArgumentError for a task whose cameras are not in the release.
    """
    marks, changed = [], dict(node)
    if release_parts.assets_folder is not None:
        folder = str(Path(release_parts.assets_folder).resolve())
        changed["objects"] = _with_release_assets(node.get("objects", {}), folder)
        marks += [RELEASE_ASSETS] if changed["objects"] != node.get("objects", {}) else []
    if release_parts.cameras_of is not None:
        task = str(node.get("code") or name).rpartition(".")[2]
        if task not in known_cameras():
            raise ArgumentError(
                f"the release has no cameras of {task!r}; it has some of {', '.join(known_cameras())}"
            )
        changed["cameras"] = {**node.get("cameras", {}), **known_cameras()[task]}
        marks.append(RELEASE_CAMERAS)
    if not marks:
        return name, node
    marked_name = MARK_SEPARATOR.join([name, *marks])
    changed |= {"name": marked_name, "title": f"{node['title']} ({release_label(marks)})"}
    return marked_name, changed | {"code": node.get("code") or f"rf_exp.tasks.{name}"}


def split_marks(name: str) -> tuple[str, list[str]]:
    """(name without marks, marks) of the name of a task."""
    task, *marks = name.split(MARK_SEPARATOR)
    return task, marks


def release_label(marks: Sequence[str]) -> str:
    """Text such as `assets and cameras of the release`, for marks of `split_marks`."""
    return f"{' and '.join(mark.removeprefix('release_') for mark in marks)} of the release"


@cache
def known_cameras() -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
    """Task -> camera -> its specification, as in a task's configuration."""
    node: Any = yaml.safe_load(Path(__file__).with_name("cameras.yaml").read_text("utf-8"))
    return {
        task: {name: _camera_spec(**camera) for name, camera in cameras.items()}
        for task, cameras in node.items()
    }


def _camera_spec(
    eye_m: list[float],
    target_m: list[float] | None = None,
    facing_wxyz: list[float] | None = None,
    fov_deg: float = 90.0,
) -> dict[str, Any]:
    """Specification of a camera that looks at a point, or has the orientation of a quaternion."""
    turn_deg = [0.0, 0.0, 0.0]
    if facing_wxyz is not None:
        rotation = Rotation.from_quat(facing_wxyz, scalar_first=True).as_matrix() @ SAPIEN_FROM_OPENCV
        world_from_camera = transform(eye_m, Rotation.from_matrix(rotation))
        (x, y, z), (to_x, to_y, to_z) = eye_m, (world_from_camera[:3, 3] + world_from_camera[:3, 2]).tolist()
        target_m = [to_x, to_y, to_z]
        upright = CameraSpec((x, y, z), (to_x, to_y, to_z)).world_from_camera
        rotation_off_target = Rotation.from_matrix((inverse(upright) @ world_from_camera)[:3, :3])
        turn_deg = np.rad2deg(rotation_off_target.as_rotvec()).round(6).tolist()
    return {"eye_m": eye_m, "target_m": target_m, "fov_deg": fov_deg, "turn_deg": turn_deg}


def _with_release_assets(objects: Mapping[str, Any], folder: str) -> dict[str, Any]:
    """The objects of a task, with release assets where the release has them."""
    specs = {}
    for key, spec in objects.items():
        specs[key], like = spec, spec.get("asset")
        if like not in assets.release_sources():
            continue
        options = {"folder": folder, "like": like, **spec.get("options", {})}
        specs[key] = {**spec, "asset": RELEASE_MODULE, "options": options}
        bearer = objects.get(spec.get("relative_to"), {}).get("asset")
        if (seat_m := assets.seat_m(folder, like, bearer)) is not None:
            specs[key]["z_m"] = round(seat_m, 6)
    return specs
