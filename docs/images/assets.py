"""Renders docs/images/assets.png, all built-in assets as policies see them: python docs/images/assets.py"""

from pathlib import Path

import cv2
import numpy as np

from rf_exp.sim import Simulator
from rf_exp.tasks import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Task, assets
from rf_exp.transforms import planar

COLUMNS = 4
YAW_DEG = 35.0
FAR = 1.6  # distance of the camera in diagonals of the asset


def picture(name: str, **options: str) -> np.ndarray:
    """RGB picture (240, 320, 3) of one asset on the table, filling the frame."""
    asset = assets.load(name, options)
    low, high = asset.bounds_m
    middle = (low + high) / 2 @ planar(0, 0, np.deg2rad(YAW_DEG))[:3, :3].T
    far_m = FAR * float(np.linalg.norm(high - low))
    eye = middle + far_m * np.array([0.75, 0.0, 0.66])
    camera = CameraSpec(tuple(eye.tolist()), tuple(middle.tolist()), 40.0)
    task = Task(
        name=name,
        title=name,
        description="",
        target_condition="",
        robots=(RobotSpec(1.2, 1.2, 0.0),),
        objects={name: ObjectSpec(name, yaw_deg=(YAW_DEG, YAW_DEG), options=options)},
        cameras={"global": camera, "agent1": camera},
        success={},
        randomisation=Randomisation(0.0, 0.0, 0.0, 0.0),
    )
    with Simulator(task) as simulator:
        image = simulator.images()["global"]
    words = " ".join([*options.values(), name])
    return cv2.putText(image, words, (8, 228), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2, cv2.LINE_AA)


def main() -> None:
    tiles = [picture(name) for name in assets.available() if name != "cube"]
    tiles += [picture("cube", colour=colour) for colour in ("blue", "red", "green")]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(Path(__file__).with_suffix(".png")), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main()
