"""The pictures of a store as a policy takes them: of several cameras side by side, and cut out."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.errors import ArgumentError
from rf_exp.policy.config import PolicyConfig

if TYPE_CHECKING:
    from rf_exp.store import Store


def pictures_of(store: "Store", camera: str, config: PolicyConfig) -> NDArray[np.uint8]:
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
    """Pictures (..., H, W, 3) of several cameras as one (..., H, sum of W, 3); of one, that itself."""
    return pictures[0] if len(pictures) == 1 else np.concatenate(pictures, axis=-2)


def crop(
    pictures: Tensor, frames: NDArray[np.int64], corners: NDArray[np.int64], size: tuple[int, int]
) -> Tensor:
    """Copies of pictures (K, H, W, 3) by index (U,), cut to size (h, w) at upper left corners (U, 2).

    Neighbouring frames with one corner are cut in one slice: whole runs are cheaper to copy than a gather.
    """
    height, width = size
    cut = np.flatnonzero((np.diff(frames) != 1) | (np.diff(corners, axis=0) != 0).any(axis=1)) + 1
    parts = []
    for piece in np.split(np.arange(len(frames)), cut):
        first, (top, left) = frames[piece[0]], corners[piece[0]]
        parts.append(pictures[first : first + len(piece), top : top + height, left : left + width])
    return torch.cat(parts)


def with_margin(pictures: Tensor, margin_px: int) -> Tensor:
    """Pictures (K, H, W, 3) with their outermost pixels repeated for so far on all sides."""
    for axis in (1, 2):
        size = pictures.shape[axis]
        pixels = torch.arange(-margin_px, size + margin_px, device=pictures.device).clamp(0, size - 1)
        pictures = pictures.index_select(axis, pixels)
    return pictures
