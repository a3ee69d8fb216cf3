"""The arms of a scene that was read, while they are driven."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.sim import Stepped, Stock
from rf_exp.transforms import Matrix
from rf_exp.types import Scene


class Driven:
    """Takes commands until the environment ends its episode; scenes are those of the objects' frames."""

    def __init__(self, stock: Stock, frames: Mapping[str, Matrix]) -> None:
        """`frames`: object -> body_from_object (4, 4)."""
        self._stock, self._frames = stock, frames
        self.told: NDArray[np.float64] | None = None  # (N, A) the last command
        self.last: Stepped | None = None  # what the environment said of the last step of a plan

    @property
    def scene(self) -> Scene:
        """What is measured now."""
        scene = self._stock.scene()
        return replace(scene, poses={name: pose @ self._frames[name] for name, pose in scene.poses.items()})

    @property
    def over(self) -> bool:
        """Whether the environment has ended its episode."""
        return self.last is not None and (self.last.terminated or self.last.truncated)

    def take(self, command: NDArray[np.float64]) -> None:
        """One control step."""
        self.told, self.last = command, self._stock.step(command)
