"""Layout of robots, objects and cameras: a circle about the objects that others are put on. Lengths in m."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rf_exp.compose.sentence import Sentence
from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.shared import circle

BASE_RADII_M = (0.6, 0.62, 0.7, 0.72, 0.74, 0.78)  # radius of the circle of arms, for 1 to 6 arms
MAX_REACH_M = 0.72  # largest distance from a base to an object that it grasps
MIN_GAP_M, JITTER_M = 0.03, 0.015  # minimum gap of two objects; largest offset of each from its place
TARGET_SPACING_M = 0.28  # between the centres of two objects that others are put on
FOV_DEG = 44.0  # of each arm's camera: objects are nearer to the centre than in families
MAX_PLACE_HEIGHT_M = 0.3  # largest height of a place over the table: on seven cubes
STEP_LIMIT = {"first": 120, "each": 200}  # of the step limit: base, and per object to move


def lay_out(
    sentence: Sentence, assets: Mapping[str, Asset], specs: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Robots, objects, cameras and step_limit of a task. Raises ArgumentError where objects do not fit."""
    _check_heights(sentence, assets)
    radius_m = BASE_RADII_M[sentence.arms - 1]
    moved = [job.thing for job in sentence.jobs]
    fixed = [name for name in assets if name not in moved]
    # Objects that others are put on form a row in the centre, in front of the bases of two arms.
    objects = {
        name: {**specs[name], "x_m": float((index - (len(fixed) - 1) / 2) * TARGET_SPACING_M), "y_m": 0.0}
        for index, name in enumerate(fixed)
    }
    max_half_width_m, offset_m = max(_half_width_m(assets[name]) for name in moved), 2 * JITTER_M
    clearance_m = (
        max(_half_width_m(assets[name]) for name in fixed) + max_half_width_m + MIN_GAP_M + offset_m
        if fixed
        else 0.0
    )
    circle_radius_m = clearance_m + TARGET_SPACING_M * (len(fixed) - 1) / 2
    # One arm reaches the half of the circle in front of it.
    span = np.pi if sentence.arms == 1 else 2 * np.pi
    first_angle = (
        -np.pi + np.pi / (2 * len(moved)) if sentence.arms == 1 else circle.angle_rad(1, 1) + np.pi / 4
    )
    angles = first_angle + span * np.arange(len(moved)) / len(moved)
    spacing_m = 2 * max_half_width_m + MIN_GAP_M + offset_m
    if len(moved) > 1:
        circle_radius_m = max(circle_radius_m, spacing_m / 2 / np.sin(span / len(moved) / 2))
    bases = np.array([[robot["x_m"], robot["y_m"]] for robot in circle.robots(sentence.arms, radius_m)])
    for name, angle in zip(moved, angles, strict=True):
        x_m, y_m = float(circle_radius_m * np.cos(angle)), float(circle_radius_m * np.sin(angle))
        distance_m = float(np.linalg.norm(bases - (x_m, y_m), axis=1).min())
        if distance_m > MAX_REACH_M:
            centre = ", ".join(fixed) or "the middle"
            raise ArgumentError(
                f"{len(moved)} things to move do not fit round {centre}: {name} would be {distance_m:.2f} m "
                f"from the nearest of {sentence.arms} arms, which reach {MAX_REACH_M} m; use fewer things or "
                "more arms"
            )
        x_m, y_m = round(x_m, 3), round(y_m, 3)
        ranges = {"x_m": [x_m - JITTER_M, x_m + JITTER_M], "y_m": [y_m - JITTER_M, y_m + JITTER_M]}
        objects[name] = {**specs[name], **ranges, "yaw_deg": [-180, 180]}
    step_limit = STEP_LIMIT["first"] + STEP_LIMIT["each"] * len(moved)
    cameras = circle.cameras(sentence.arms, radius_m)
    agent_cameras = {
        name: {**camera, "fov_deg": FOV_DEG} for name, camera in cameras.items() if name != "global"
    }
    layout = {"robots": circle.robots(sentence.arms, radius_m), "cameras": {**cameras, **agent_cameras}}
    return {**layout, "objects": objects, "step_limit": step_limit}


def _check_heights(sentence: Sentence, assets: Mapping[str, Asset]) -> None:
    """Raises ArgumentError for an object that would be put higher than MAX_PLACE_HEIGHT_M."""
    tops_m: dict[str, float] = {}
    for job in sentence.jobs:
        point = assets[job.target].points[job.point].object_from_tcp
        tops_m[job.thing] = tops_m.get(job.target, 0.0) + float(point[2, 3])
        if tops_m[job.thing] > MAX_PLACE_HEIGHT_M:
            raise ArgumentError(
                f"{job.thing} would stand {tops_m[job.thing]:.2f} m over the table; arms build up to "
                f"{MAX_PLACE_HEIGHT_M} m"
            )


def _half_width_m(asset: Asset) -> float:
    """Upper bound on half the width of an asset, seen from above."""
    return float(np.linalg.norm(np.abs(asset.bounds_m[:, :2]).max(axis=0)))
