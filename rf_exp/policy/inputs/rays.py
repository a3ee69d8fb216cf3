"""Rays: the lines along which the places of a picture are seen, in the base frame of an arm.

A camera is a matrix (3, 4), [A | c]: what is at the place (x, y) of its picture, from 0 to 1 to the right and
down, lies on c + t A (x, y, 1), in m. A camera that has moved has another matrix, and the same keypoints.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.policy.inputs.view import Stream
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import Matrix, inverse, planar
from rf_exp.types import Calibration, CameraModel

if TYPE_CHECKING:
    from rf_exp.store import Store


def rays_of(calibration: Calibration, stream: Stream) -> NDArray[np.float32]:
    """(K, 3, 4) of the cameras of a stream, whose pictures lie side by side, from the first agent's base."""
    base_from_world = inverse(calibration.world_from_base[stream.agents[0] - 1])
    count, found = len(stream.cameras), []
    for row, name in enumerate(stream.cameras):
        camera = calibration.cameras[name]
        base_from_camera = base_from_world @ camera.world_from_camera
        width, height = camera.width_px, camera.height_px
        pixels_from_place = np.array([[count * width, 0, -row * width], [0, height, 0], [0, 0, 1.0]])
        directions = base_from_camera[:3, :3] @ np.linalg.inv(camera.intrinsics) @ pixels_from_place
        found.append(np.column_stack([directions, base_from_camera[:3, 3]]))
    return np.stack(found).astype(np.float32)


def calibrations(store: "Store", names: tuple[str, ...]) -> list[Calibration]:
    """Where arms and the named cameras stood in each episode of a store. Raises as `usual_calibration`."""
    usual, found = usual_calibration(store, names), []
    for certificate in store.certificates:
        if (said := certificate.get("calibration")) is None:
            found.append(usual)
            continue
        bases = tuple(np.array(pose) for pose in said["world_from_base"])
        seen = {name: said["cameras"][name] for name in names}
        cameras = {
            name: _camera(store, each["fov_deg"], np.array(each["parent_from_camera"]))
            for name, each in seen.items()
        }
        found.append(Calibration(bases, cameras))
    return found


def usual_calibration(store: "Store", names: tuple[str, ...]) -> Calibration:
    """Where arms and the named cameras of a store usually stand.

    Raises ArgumentError where it does not say so, and for a moving camera.
    """
    try:
        scene = store.identity["scene"]
        specs = {name: CameraSpec(**scene["cameras"][name]) for name in names}
        bases = tuple(
            planar(each["x_m"], each["y_m"], np.deg2rad(each["yaw_deg"]), each.get("z_m", 0))
            for each in scene["robots"]
        )
    except KeyError as error:
        raise ArgumentError(
            f"{store.path} does not say where its cameras stand; generate it again"
        ) from error
    for name, spec in specs.items():
        if spec.mount != "world":
            raise ArgumentError(
                f"camera {name!r} rides on a hand; the keypoint encoder needs one that stands still"
            )
    cameras = {name: _camera(store, spec.fov_deg, spec.world_from_camera) for name, spec in specs.items()}
    return Calibration(bases, cameras)


def _camera(store: "Store", fov_deg: float, pose: Matrix) -> CameraModel:
    return CameraModel(store.attrs["width"], store.attrs["height"], float(np.deg2rad(fov_deg)), pose)
