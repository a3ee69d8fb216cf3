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

from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks import assets
from rf_exp.tasks.task.specs import CameraSpec
from rf_exp.transforms import inverse, transform

RELEASE = "release"
MARK = "+"  # in names, between a task and its borrowed parts
ASSETS, CAMERAS = "release_assets", "release_cameras"
FACING = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # rotation of camera axes: sapien_from_opencv
MODULE = "rf_exp.tasks.assets.asset.annotated"


@dataclass(frozen=True)
class Borrowed:
    """Parts that tasks borrow from the release. Raises ArgumentError for inconsistent keys."""

    assets: str | None = None  # release
    assets_folder: str | None = None
    cameras_of: str | None = None  # release

    def __post_init__(self) -> None:
        for key in ("assets", "cameras_of"):
            if (value := getattr(self, key)) not in (None, RELEASE):
                raise choices(key, value, (RELEASE, "null"))
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


def with_release(name: str, node: Mapping[str, Any], borrowed: Borrowed) -> tuple[str, Mapping[str, Any]]:
    """Name and configuration of a task with its borrowed parts.

    Raises ArgumentError for a task whose cameras are not in the release.
    """
    marks, changed = [], dict(node)
    if borrowed.assets_folder is not None:
        folder = str(Path(borrowed.assets_folder).resolve())
        changed["objects"] = _objects(node.get("objects", {}), folder)
        marks += [ASSETS] if changed["objects"] != node.get("objects", {}) else []
    if borrowed.cameras_of is not None:
        task = str(node.get("code") or name).rpartition(".")[2]
        if task not in known_cameras():
            raise ArgumentError(
                f"the release has no cameras of {task!r}; it has some of {', '.join(known_cameras())}"
            )
        changed["cameras"] = {**node.get("cameras", {}), **known_cameras()[task]}
        marks.append(CAMERAS)
    if not marks:
        return name, node
    called = MARK.join([name, *marks])
    changed |= {"name": called, "title": f"{node['title']} ({borrowed_words(marks)})"}
    return called, changed | {"code": node.get("code") or f"rf_exp.tasks.{name}"}


def unmarked(name: str) -> tuple[str, list[str]]:
    """(name without marks, marks) of the name of a task."""
    task, *marks = name.split(MARK)
    return task, marks


def borrowed_words(marks: Sequence[str]) -> str:
    """Text such as `assets and cameras of the release`, for marks of `unmarked`."""
    return f"{' and '.join(mark.removeprefix('release_') for mark in marks)} of the release"


@cache
def known_cameras() -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
    """Task -> camera -> its specification, as in a task's configuration."""
    node: Any = yaml.safe_load(Path(__file__).with_name("cameras.yaml").read_text("utf-8"))
    return {task: {name: _spec(**camera) for name, camera in those.items()} for task, those in node.items()}


def _spec(
    eye_m: list[float],
    target_m: list[float] | None = None,
    facing_wxyz: list[float] | None = None,
    fov_deg: float = 90.0,
) -> dict[str, Any]:
    """Specification of a camera that looks at a point, or has the orientation of a quaternion."""
    turn_deg = [0.0, 0.0, 0.0]
    if facing_wxyz is not None:
        faces = Rotation.from_quat(facing_wxyz, scalar_first=True).as_matrix() @ FACING
        stands = transform(eye_m, Rotation.from_matrix(faces))
        (x, y, z), (to_x, to_y, to_z) = eye_m, (stands[:3, 3] + stands[:3, 2]).tolist()
        target_m = [to_x, to_y, to_z]
        upright = CameraSpec((x, y, z), (to_x, to_y, to_z)).world_from_camera
        off = Rotation.from_matrix((inverse(upright) @ stands)[:3, :3])
        turn_deg = np.rad2deg(off.as_rotvec()).round(6).tolist()
    return {"eye_m": eye_m, "target_m": target_m, "fov_deg": fov_deg, "turn_deg": turn_deg}


def _objects(objects: Mapping[str, Any], folder: str) -> dict[str, Any]:
    """The objects of a task, with release assets where the release has them."""
    found = {}
    for key, spec in objects.items():
        found[key], like = spec, spec.get("asset")
        if like not in assets.released():
            continue
        options = {"folder": folder, "like": like, **spec.get("options", {})}
        found[key] = {**spec, "asset": MODULE, "options": options}
        bearer = objects.get(spec.get("relative_to"), {}).get("asset")
        if (seat_m := assets.seat_m(folder, like, bearer)) is not None:
            found[key]["z_m"] = round(seat_m, 6)
    return found
