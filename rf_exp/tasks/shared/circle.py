"""Layouts with arms in a circle that face its centre, shared by families. Lengths in m, angles in rad or deg.

Positions before an arm are given in its base frame: x towards the centre, y to its left, z up.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rf_exp.transforms import planar

# Rest posture, folded so that eight grippers keep clear of each other: the TCP is 0.33 m before the base and
# 0.42 m above the table, pointing down.
REST_RAD = (0.0, -0.75, 0.0, -2.5, 0.0, 1.75, 0.785)
GLOBAL = {"out_m": 0.8, "up_m": 1.75, "fov_deg": 52.0}  # global camera, in a direction between two arms
EYE_M, TARGET_M, FOV_DEG = (1.02, 0.16, 0.82), (0.5, 0.0, 0.1), 52.0  # agent cameras, in the base frame

COLOURS = ("blue", "red", "green")
Numbers = Mapping[str, float]  # parameters of a layout, by name


def angle_rad(arm: int, arms: int) -> float:
    """Angle of the base of an arm (1-based) about the centre; the first one is at -90 degrees."""
    return 2 * np.pi * (arm - 1) / arms - np.pi / 2


def in_front_of_arm(
    arm: int, arms: int, radius_m: float, forward_m: float, left_m: float = 0.0
) -> dict[str, Any]:
    """World x and y of a position before an arm, and the yaw of the arm's base."""
    angle = angle_rad(arm, arms)
    base = planar(radius_m * np.cos(angle), radius_m * np.sin(angle), angle + np.pi)
    x_m, y_m = (base @ (forward_m, left_m, 0.0, 1.0))[:2].tolist()
    yaw_deg = float(np.rad2deg(angle) + 180.0)
    return {"x_m": round(x_m, 6), "y_m": round(y_m, 6), "yaw_deg": round(yaw_deg, 6)}


def robots(arms: int, radius_m: float) -> list[dict[str, Any]]:
    """Robots evenly spaced on a circle."""
    return [{**in_front_of_arm(arm, arms, radius_m, 0.0), "rest_rad": REST_RAD} for arm in range(1, arms + 1)]


def cameras(arms: int, radius_m: float) -> Mapping[str, Any]:
    """The global camera, and one per agent that looks at its arm from across the centre."""
    angle = -np.pi / 2 + np.pi / max(arms, 2)
    out_m, up_m = GLOBAL["out_m"], GLOBAL["up_m"]
    eye_m = (out_m * np.cos(angle), out_m * np.sin(angle), up_m)
    views: dict[str, Any] = {"global": _camera(eye_m, (0.0, 0.0, 0.1), GLOBAL["fov_deg"])}
    for arm in range(1, arms + 1):
        eye, target = (in_front_of_arm(arm, arms, radius_m, *at[:2]) for at in (EYE_M, TARGET_M))
        eye_m, target_m = (eye["x_m"], eye["y_m"], EYE_M[2]), (target["x_m"], target["y_m"], TARGET_M[2])
        views[f"agent{arm}"] = _camera(eye_m, target_m, FOV_DEG)
    return views


def robots_and_cameras(arms: int, radius_m: float) -> dict[str, Any]:
    """Robots and cameras of a task."""
    return {"robots": robots(arms, radius_m), "cameras": cameras(arms, radius_m)}


def cube(
    arm: int,
    arms: int,
    k: int,
    things: int,
    radius_m: float,
    forward_m: float,
    apart_m: float,
    jitter_m: float,
) -> dict[str, Any]:
    """The k-th cube (0-based) of a row before an arm, at most `jitter_m` / `things`^2 off its place."""
    position = in_front_of_arm(arm, arms, radius_m, forward_m, ((things - 1) / 2 - k) * apart_m)
    # Less jitter in a longer row: the gaps between cubes leave little space for fingers.
    return cube_at(position["x_m"], position["y_m"], jitter_m / things**2, arm + k - 1)


def cube_at(x_m: float, y_m: float, jitter_m: float, colour: int) -> dict[str, Any]:
    """A cube that starts at most `jitter_m` off a place along x and y, at any yaw."""
    ranges = {"x_m": [x_m - jitter_m, x_m + jitter_m], "y_m": [y_m - jitter_m, y_m + jitter_m]}
    options = {"colour": COLOURS[colour % len(COLOURS)]}
    return {"asset": "cube", "options": options, **ranges, "yaw_deg": [-180.0, 180.0]}


def goal_at(x_m: float, y_m: float, radius_m: float) -> dict[str, Any]:
    """A goal on the table."""
    return {"asset": "goal", "options": {"radius_m": radius_m}, "x_m": x_m, "y_m": y_m}


def agent_of_object(name: str) -> int:
    """The agent whose object this is, from its name: 2 for cube2_1."""
    return int(name.lstrip("abcdefghijklmnopqrstuvwxyz").split("_")[0])


def _camera(eye_m: tuple, target_m: tuple, fov_deg: float) -> dict[str, Any]:
    eye, target = ([round(float(value), 6) for value in point] for point in (eye_m, target_m))
    return {"eye_m": eye, "target_m": target, "fov_deg": fov_deg}
