"""What a controller is shown of a scene: the keys and arrays of the environments, and of policies of others.

Keys are those of the store: `qpos` and `qvel`, `pose_<object>`, `rgb_<camera>`; then `depth_<camera>`,
`segmentation_<camera>` and `language`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks import Task, labelled
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import CameraChoice, Pictures, Scene, camera_names

State = Literal["full", "joints", "none"]

Observation = dict[str, Any]  # key -> array, or a string for `language`


@dataclass(frozen=True)
class Observations:
    """What a controller is shown. Raises ArgumentError for values that are not possible.

    `state`: `full` is all joints and the poses of all objects, `joints` what an arm measures of itself,
    `none` neither. `pictures`, `depth` and `segmentation` are taken by `cameras`, as `width` x `height` px;
    without them nothing is drawn, and no Vulkan device is needed.
    """

    state: State = "full"
    pictures: bool = False  # (H, W, 3) uint8, RGB
    depth: bool = False  # (H, W) float32, metres along the viewing direction, to the millimetre; 0 is nothing
    segmentation: bool = False  # (H, W) uint8, numbers of `labels`
    language: bool = False  # the task, in a sentence or two
    cameras: CameraChoice = "all"  # all | local (those of the agents) | global
    width: int = 320
    height: int = 240

    def __post_init__(self) -> None:
        if self.state not in get_args(State):
            raise choices("state", self.state, get_args(State))
        Pictures(self.width, self.height, self.draws, self.cameras)  # looks at its arguments
        if self.state == "none" and not (self.draws or self.language):
            raise ArgumentError(
                "nothing is observed; expected state, pictures, depth, segmentation or language"
            )

    @property
    def draws(self) -> bool:
        """Whether a camera has to look."""
        return self.pictures or self.depth or self.segmentation


class Shown(Protocol):
    """What there is to look at (given by `rf_exp.sim`), by names of cameras, at the present step."""

    @property
    def task(self) -> Task: ...

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]: ...

    def depth(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.float32]]: ...

    def segmentation(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.int32]]: ...

    def bodies(self) -> dict[str, tuple[int, ...]]:
        """Body of `labels` -> its numbers in a segmentation."""
        ...


class Eyes:
    """Observes the present step of a simulator, for one controller of all arms."""

    def __init__(self, seen: Observations, world: Shown) -> None:
        self._seen, self._world, self._task = seen, world, world.task
        self._cameras = camera_names(seen.cameras, len(world.task.agents))
        self._poses = [(f"pose_{name}", name) for name in world.task.objects]

    def __call__(self, scene: Scene) -> Observation:
        """What there is to see; all arrays are new ones."""
        seen, shown = self._seen, Observation()
        if seen.state != "none":
            shown["qpos"], shown["qvel"] = scene.qpos.astype(np.float32), scene.qvel.astype(np.float32)
        if seen.state == "full":
            for key, name in self._poses:
                shown[key] = np.array(position_and_quaternion(scene.poses[name]), np.float32)
        if seen.pictures:
            shown |= _named("rgb", self._world.images(self._cameras))
        if seen.depth:
            shown |= _named("depth", self._world.depth(self._cameras))
        if seen.segmentation:
            images = self._world.segmentation(self._cameras)
            shown |= _named("segmentation", labelled(self._task, images, self._world.bodies()))
        if seen.language:
            shown["language"] = self._task.description
        return shown


def _named(kind: str, images: Mapping[str, NDArray]) -> Observation:
    return {f"{kind}_{name}": image for name, image in images.items()}
