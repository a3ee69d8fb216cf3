"""Transforms between this suite and openpi, for one policy of all arms: docs/foreign.md.

In the training configuration of openpi, over an export of ours (`--format lerobot_v21`):

    from examples.foreign.openpi_transforms import Inputs, Outputs
    transforms = Group(inputs=[Inputs(agents=2)], outputs=[Outputs(agents=2)])

A transform there is any function from a dictionary to a dictionary; this file needs NumPy alone. Of each arm
the model has eight numbers, seven joints in rad and a gripper: pi0's 32 hold four arms. It takes three
pictures.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SLOTS = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")  # as pi0 calls its pictures
OPEN_M = 0.04  # of each finger of the Panda's hand
ARM, COMMANDS = 7, 8


@dataclass(frozen=True)
class Inputs:
    """An observation, or a row of an export, as pi0 takes it: its slots hold the first cameras there are."""

    agents: int
    cameras: tuple[str, ...] = ("global", "agent1", "agent2")

    def __call__(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """`state` (N * 8,), `image` and `image_mask` by slot, `prompt`; of a row `actions` (T, N * 8) too."""
        qpos = np.asarray(data["qpos"] if "qpos" in data else data["observation.state"], np.float32)
        qpos = qpos.reshape(self.agents, -1)
        # Measured is the opening of both fingers, commanded -1 (closed) to 1 (open): one scale for both.
        gripper = qpos[:, ARM:].mean(axis=1, keepdims=True) / OPEN_M * 2 - 1
        pictures = [found for name in self.cameras if (found := _picture(data, name)) is not None]
        if not pictures:
            raise ValueError(f"none of the cameras {self.cameras} is in {sorted(data)}")
        shown = dict(zip(SLOTS, pictures, strict=False))
        made = {
            "state": np.hstack([qpos[:, :ARM], gripper]).ravel(),
            "image": {slot: shown.get(slot, np.zeros_like(pictures[0])) for slot in SLOTS},
            "image_mask": {slot: np.bool_(slot in shown) for slot in SLOTS},
        }
        words = data.get("language", data.get("prompt", data.get("task")))
        made |= {} if words is None else {"prompt": words}
        actions = data.get("action", data.get("actions"))
        return made if actions is None else made | {"actions": np.asarray(actions, np.float32)}


@dataclass(frozen=True)
class Outputs:
    """A chunk of the model, padded to its size, as the suite takes it: (T, N * 8)."""

    agents: int

    def __call__(self, data: Mapping[str, Any]) -> dict[str, NDArray[np.floating]]:
        return {"actions": np.asarray(data["actions"])[:, : self.agents * COMMANDS]}


def _picture(data: Mapping[str, Any], camera: str) -> NDArray[np.uint8] | None:
    """(H, W, 3) of a camera, which a row of an export has as (3, H, W) from 0 to 1; None: it is not there."""
    found = data.get(f"rgb_{camera}", data.get(f"observation.images.{camera}"))
    if found is None:
        return None
    picture = np.asarray(found)
    if np.issubdtype(picture.dtype, np.floating):
        picture = np.rint(255 * picture).astype(np.uint8)
    return picture.transpose(1, 2, 0) if picture.shape[0] == 3 else picture
