"""Named measurements on a scene, so that success criteria read in words."""

import numpy as np

from rf_exp.transforms import Matrix
from rf_exp.types import Scene


def height_m(scene: Scene, name: str) -> float:
    """Height of the object's origin above the table."""
    return float(scene.poses[name][2, 3])


def risen_m(scene: Scene, start: Scene, name: str) -> float:
    """How far the object's origin is above where it started."""
    return height_m(scene, name) - height_m(start, name)


def distance_xy_m(a: Matrix, b: Matrix) -> float:
    """Distance of two origins on the table."""
    return float(np.linalg.norm(a[:2, 3] - b[:2, 3]))


def tilt_deg(pose: Matrix) -> float:
    """Angle between the object's z axis and the vertical."""
    return float(np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0))))


def still(scene: Scene, name: str, below_m_s: float) -> bool:
    """Whether the object moves slower than a bound."""
    return scene.speeds[name] < below_m_s


def holders(scene: Scene, name: str) -> tuple[int, ...]:
    """The agents that pinch the object between their fingers."""
    return tuple(agent for agent, held in enumerate(scene.held, start=1) if held == name)
