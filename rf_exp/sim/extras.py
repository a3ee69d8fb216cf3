"""What is where in a picture: depth as it is stored, and bodies by numbers that all scenes of a task have."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rf_exp.sim.simulator import Simulator
from rf_exp.tasks import labelled
from rf_exp.types import Extras


def segmentation(world: Simulator, cameras: Iterable[str]) -> dict[str, NDArray[np.uint8]]:
    """Camera -> (H, W) index of `labels`, at the present step."""
    return labelled(world.task, world.segmentation(cameras), world.bodies())


def depth_mm(world: Simulator, cameras: Iterable[str]) -> dict[str, NDArray[np.uint16]]:
    """Camera -> (H, W) millimetres along the viewing direction, at the present step; 0 is nothing."""
    return {name: np.rint(image * 1000).astype(np.uint16) for name, image in world.depth(cameras).items()}


def depth_and_segmentation(world: Simulator, cameras: Iterable[str], extras: Extras) -> dict[str, NDArray]:
    """`depth_<camera>` (H, W) u16 mm and `segmentation_<camera>` (H, W) u8, of what `extras` asks for."""
    found: dict[str, NDArray] = {}
    if extras.depth:
        found |= {f"depth_{name}": image for name, image in depth_mm(world, cameras).items()}
    if extras.segmentation:
        found |= {f"segmentation_{name}": image for name, image in segmentation(world, cameras).items()}
    return found
