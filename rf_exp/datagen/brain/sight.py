"""Which of the cameras' pictures go with a question, and how large."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast, get_args

from rf_exp.errors import ArgumentError, choices
from rf_exp.types import LARGEST_PX, SMALLEST_PX, CameraChoice, Pictures, camera_names

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

JPEG_QUALITY = 90


@dataclass(frozen=True)
class Sight:
    """What a model is shown. Raises ArgumentError for other cameras, and for sizes no picture has."""

    cameras: str  # all | local | global
    longer_px: int | None  # longer side of a picture, to which it is scaled; None: as it was taken

    def __post_init__(self) -> None:
        if self.cameras not in get_args(CameraChoice):
            raise choices("brain.cameras", self.cameras, get_args(CameraChoice))
        if self.longer_px is not None and not SMALLEST_PX <= self.longer_px <= LARGEST_PX:
            raise ArgumentError(
                f"brain.picture_px is {self.longer_px}; possible are {SMALLEST_PX} to {LARGEST_PX} pixels, "
                "and null: as the cameras take them"
            )

    def check(self, taken: Pictures) -> None:
        """Raises ArgumentError where cameras are named whose pictures are not taken."""
        if self.cameras == "all":
            return
        if not taken.render:
            raise ArgumentError(
                f"brain.cameras={self.cameras}, but render=false takes no pictures; use render=true, "
                "brain.pictures=false or brain.cameras=all: of those there are"
            )
        if taken.cameras not in ("all", self.cameras):
            raise ArgumentError(
                f"brain.cameras={self.cameras}, but cameras={taken.cameras} takes other pictures; use "
                f"cameras=all, cameras={self.cameras} or brain.cameras=all: of those there are"
            )

    def jpegs(self, pictures: "Mapping[str, NDArray[np.uint8]]", agents: int) -> dict[str, bytes]:
        """Camera -> JPEG, of those chosen among pictures (H, W, 3) RGB of a scene with so many agents."""
        chosen = camera_names(cast(CameraChoice, self.cameras), agents)
        return {name: self._jpeg(picture) for name, picture in pictures.items() if name in chosen}

    def _jpeg(self, picture: "NDArray[np.uint8]") -> bytes:
        import cv2  # slow to import for who asks no model

        bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        if self.longer_px is not None:
            height, width = picture.shape[:2]
            scale = self.longer_px / max(height, width)
            size = max(1, round(width * scale)), max(1, round(height * scale))
            bgr = cv2.resize(bgr, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        return cv2.imencode(".jpg", bgr, quality)[1].tobytes()
