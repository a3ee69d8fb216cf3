"""Transforms between this suite and openpi, for one policy of all arms: docs/foreign.md.

In the training configuration of openpi, over an export of ours (`--format lerobot_v21`):

    from examples.foreign.openpi_transforms import Inputs, Outputs
    transforms = Group(inputs=[Inputs(agents=2)], outputs=[Outputs(agents=2)])

A transform of openpi is any function from a dictionary to a dictionary; this file needs only NumPy. The model
has eight numbers per arm, seven joints in rad and a gripper: pi0's 32 suffice for four arms. It takes three
pictures.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SLOTS = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")  # names of pi0's pictures
OPEN_M = 0.04  # opening of each finger of the Panda's gripper
ARM, COMMANDS = 7, 8


@dataclass(frozen=True)
class Inputs:
    """Input transform: an observation or a row of an export to pi0's format, with up to three `cameras`."""

    agents: int
    cameras: tuple[str, ...] = ("global", "agent1", "agent2")

    def __call__(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """`state` (N * 8,), `image` and `image_mask` by slot, `prompt`; for a row also `actions` (T, N * 8).

        Raises ValueError for data without any of the cameras.
        """
        qpos = np.asarray(data["qpos"] if "qpos" in data else data["observation.state"], np.float32)
        qpos = qpos.reshape(self.agents, -1)
        # The state has the openings of two fingers, actions -1 (closed) to 1 (open): use the latter for both.
        gripper = qpos[:, ARM:].mean(axis=1, keepdims=True) / OPEN_M * 2 - 1
        pictures = [picture for name in self.cameras if (picture := _picture(data, name)) is not None]
        if not pictures:
            raise ValueError(f"none of the cameras {self.cameras} is in {sorted(data)}")
        images = dict(zip(SLOTS, pictures, strict=False))
        inputs = {
            "state": np.hstack([qpos[:, :ARM], gripper]).ravel(),
            "image": {slot: images.get(slot, np.zeros_like(pictures[0])) for slot in SLOTS},
            "image_mask": {slot: np.bool_(slot in images) for slot in SLOTS},
        }
        prompt = data.get("language", data.get("prompt", data.get("task")))
        inputs |= {} if prompt is None else {"prompt": prompt}
        actions = data.get("action", data.get("actions"))
        return inputs if actions is None else inputs | {"actions": np.asarray(actions, np.float32)}


@dataclass(frozen=True)
class Outputs:
    """Output transform: a chunk of the model, with padding, to one of the suite (T, N * 8)."""

    agents: int

    def __call__(self, data: Mapping[str, Any]) -> dict[str, NDArray[np.floating]]:
        return {"actions": np.asarray(data["actions"])[:, : self.agents * COMMANDS]}


def _picture(data: Mapping[str, Any], camera: str) -> NDArray[np.uint8] | None:
    """The picture (H, W, 3) of a camera, (3, H, W) from 0 to 1 in rows of an export; None without one."""
    array = data.get(f"rgb_{camera}", data.get(f"observation.images.{camera}"))
    if array is None:
        return None
    picture = np.asarray(array)
    if np.issubdtype(picture.dtype, np.floating):
        picture = np.rint(255 * picture).astype(np.uint8)
    return picture.transpose(1, 2, 0) if picture.shape[0] == 3 else picture
