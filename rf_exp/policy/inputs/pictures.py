"""Pictures of a store as inputs of a policy, and the rays of places in them.

The rays of a camera are a matrix (3, 4), [A | c]: a point at the place (x, y) of its picture, from 0 to 1 to
the right and down, lies on c + t A (x, y, 1), in m, in the footprint of an arm. A camera that has moved has
another matrix, and the same keypoints.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.errors import ArgumentError
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.inputs.observation_spec import footprint
from rf_exp.policy.inputs.view import Stream
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import inverse, planar
from rf_exp.types import Calibration

if TYPE_CHECKING:
    from rf_exp.store import Store

Array = TypeVar("Array", Tensor, NDArray)


def pictures_of(store: "Store", camera: str, config: PolicyConfig) -> NDArray[np.uint8]:
    """All pictures (T, H, W, 3) of a camera. Raises ArgumentError for none, or for another size."""
    if camera not in store.cameras:
        raise ArgumentError(
            f"the view needs camera {camera!r}, but the store has {', '.join(store.cameras) or 'none'}; "
            "generate with render=true and cameras=all"
        )
    pictures = np.asarray(store.images[camera][:])
    if pictures.shape[1:3] != (config.height, config.width):
        raise ArgumentError(
            f"pictures of camera {camera!r} are {pictures.shape[1]} x {pictures.shape[2]} pixels; "
            f"the policy expects {config.height} x {config.width}"
        )
    return pictures


def side_by_side(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures (..., H, W, 3) of several cameras as one (..., H, sum of W, 3); a single one uncopied."""
    return pictures[0] if len(pictures) == 1 else np.concatenate(pictures, axis=-2)


def crop(
    pictures: Tensor, frames: NDArray[np.int64], corners: NDArray[np.int64], size: tuple[int, int]
) -> Tensor:
    """Copies of pictures (K, H, W, 3) by index (U,), cropped to size (h, w) at upper left corners (U, 2).

    Neighbouring frames with the same corner are copied in one slice, which is cheaper than a gather.
    """
    height, width = size
    breaks = np.flatnonzero((np.diff(frames) != 1) | (np.diff(corners, axis=0) != 0).any(axis=1)) + 1
    parts = []
    for run in np.split(np.arange(len(frames)), breaks):
        first, (top, left) = frames[run[0]], corners[run[0]]
        parts.append(pictures[first : first + len(run), top : top + height, left : left + width])
    return torch.cat(parts)


def with_margin(pictures: Tensor, margin_px: int) -> Tensor:
    """Pictures (K, H, W, 3), padded on all sides with their outermost pixels."""
    for axis in (1, 2):
        # Copied as slices: a gather by index, three bytes at a time, takes eight times as long.
        side = [margin_px if k == axis else size for k, size in enumerate(pictures.shape)]
        outermost = pictures.narrow(axis, 0, 1), pictures.narrow(axis, pictures.shape[axis] - 1, 1)
        first, last = (pixels.expand(side) for pixels in outermost)
        pictures = torch.cat([first, pictures, last], dim=axis)
    return pictures


def scaled(pictures: Tensor) -> Tensor:
    """Pictures (U, h, w, 3) uint8 -> (U, 3, h, w) in [-1, 1]."""
    # Permuted to channels first they are channels_last already: no copy, the fast layout on CPUs.
    return pictures.permute(0, 3, 1, 2).float().div(127.5).sub(1.0)


def inside_picture(places: Array) -> Array:
    """Whether places (..., 2), from 0 to 1 over a picture, are inside it; NaN is not."""
    inside: Any = (places >= 0) & (places <= 1)
    return inside.all(-1)


def rays_of(calibration: Calibration, stream: Stream) -> NDArray[np.float32]:
    """Rays (K, 3, 4) of the cameras of a stream, pictures side by side, in the first agent's footprint."""
    footprint_from_world = inverse(footprint(calibration.world_from_base[stream.agents[0] - 1]))
    count, rays = len(stream.cameras), []
    for row, name in enumerate(stream.cameras):
        camera = calibration.cameras[name]
        footprint_from_camera = footprint_from_world @ camera.world_from_camera
        width, height = camera.width_px, camera.height_px
        pixels_from_place = np.array([[count * width, 0, -row * width], [0, height, 0], [0, 0, 1.0]])
        directions = footprint_from_camera[:3, :3] @ np.linalg.inv(camera.intrinsics) @ pixels_from_place
        rays.append(np.column_stack([directions, footprint_from_camera[:3, 3]]))
    return np.stack(rays).astype(np.float32)


def calibrations(store: "Store", names: tuple[str, ...]) -> list[Calibration]:
    """Calibration of arms and named cameras in each episode of a store. Raises as `usual_calibration`."""
    default, result = usual_calibration(store, names), []
    size_px = store.attrs["width"], store.attrs["height"]
    for certificate in store.certificates:
        calibration = default
        if (recorded := certificate.get("calibration")) is not None:
            cameras = {}
            for name in names:
                pose, fov_deg = (recorded["cameras"][name][key] for key in ("parent_from_camera", "fov_deg"))
                cameras[name] = CameraSpec(fov_deg=fov_deg).model(np.array(pose), size_px)
            calibration = Calibration(tuple(map(np.array, recorded["world_from_base"])), cameras)
        result.append(calibration)
    return result


def usual_calibration(store: "Store", names: tuple[str, ...]) -> Calibration:
    """Usual calibration of arms and named cameras. Raises ArgumentError for unknown and moving ones."""
    try:
        scene = store.identity["scene"]
        specs = {name: CameraSpec(**scene["cameras"][name]) for name in names}
        bases = tuple(
            planar(robot["x_m"], robot["y_m"], np.deg2rad(robot["yaw_deg"]), robot.get("z_m", 0))
            for robot in scene["robots"]
        )
    except KeyError as error:
        raise ArgumentError(
            f"{store.path} does not record the poses of its cameras; generate it again, or train "
            "policy=paper, which does not need them"
        ) from error
    for name, spec in specs.items():
        if spec.mount != "world":
            raise ArgumentError(
                f"camera {name!r} is mounted on a gripper; the keypoint encoder needs a fixed one"
            )
    size_px = store.attrs["width"], store.attrs["height"]
    cameras = {name: spec.model(spec.world_from_camera, size_px) for name, spec in specs.items()}
    return Calibration(bases, cameras)
