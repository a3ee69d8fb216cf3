"""Pictures of a subset of the cameras, and depth and segmentation beside them."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import label_images
from rf_exp.types import Extras

if TYPE_CHECKING:
    from rf_exp.sim.simulator import Simulator


class CameraSubset:
    """Simulator with pictures from some cameras only, or from none; depth is still available on request."""

    def __init__(self, world: "Simulator", cameras: Sequence[str] = ()) -> None:
        self._world, self.cameras = world, tuple(cameras)
        self.reset, self.step = world.reset, world.step
        self.depth, self.camera_models = world.depth, world.camera_models

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) RGB of the present step: of `cameras`, or of all that this simulator has."""
        return self._world.images(self.cameras if cameras is None else cameras)


def depth_and_segmentation(world: "Simulator", cameras: Iterable[str], extras: Extras) -> dict[str, NDArray]:
    """The depth and segmentation images that `extras` requests, at the present step.

    `depth_<camera>` (H, W) u16 is millimetres along the viewing direction, 0 for no surface;
    `segmentation_<camera>` (H, W) u8 is an index into `labels`, the same in all scenes of a task.
    """
    arrays: dict[str, NDArray] = {}
    if extras.depth:
        for name, image in world.depth(cameras).items():
            arrays[f"depth_{name}"] = np.rint(image * 1000).astype(np.uint16)
    if extras.segmentation:
        images = label_images(world.task, world.segmentation(cameras), world.bodies())
        arrays |= {f"segmentation_{name}": image for name, image in images.items()}
    return arrays
