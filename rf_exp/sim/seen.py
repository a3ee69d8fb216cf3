"""What is seen of a simulator where not all of it is asked for: by some cameras, and beside the pictures."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rf_exp.tasks import labelled
from rf_exp.types import Extras

if TYPE_CHECKING:
    from rf_exp.sim.simulator import Simulator


class Limited:
    """A simulator of which only some cameras, or none, take pictures, but depth when it is asked for."""

    def __init__(self, world: "Simulator", cameras: Sequence[str] = ()) -> None:
        self._world, self.cameras = world, tuple(cameras)
        self.reset, self.step = world.reset, world.step
        self.depth, self.camera_models = world.depth, world.camera_models

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) RGB of the present step: of these cameras, or of all there are."""
        return self._world.images(self.cameras if cameras is None else cameras)


def depth_and_segmentation(world: "Simulator", cameras: Iterable[str], extras: Extras) -> dict[str, NDArray]:
    """What `extras` asks for, at the present step.

    `depth_<camera>` (H, W) u16 is millimetres along the viewing direction, 0 is nothing;
    `segmentation_<camera>` (H, W) u8 is an index of `labels`, alike in all scenes of a task.
    """
    found: dict[str, NDArray] = {}
    if extras.depth:
        for name, image in world.depth(cameras).items():
            found[f"depth_{name}"] = np.rint(image * 1000).astype(np.uint16)
    if extras.segmentation:
        images = labelled(world.task, world.segmentation(cameras), world.bodies())
        found |= {f"segmentation_{name}": image for name, image in images.items()}
    return found
