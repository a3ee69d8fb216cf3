"""Layout of robots, objects and cameras: a circle about the objects that others are put on. Lengths in m."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rf_exp.compose.sentence import Sentence
from rf_exp.errors import ArgumentError
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.shared import circle

BASES_M = (0.6, 0.62, 0.7, 0.72, 0.74, 0.78)  # radius of the circle of arms, for 1 to 6 arms
REACHED_M = 0.72  # largest distance from a base to an object that it grasps
APART_M, JITTER_M = 0.03, 0.015  # minimum gap of two objects; largest offset of each from its place
TARGETS_M = 0.28  # between the centres of two objects that others are put on
FOV_DEG = 44.0  # of each arm's camera: objects are nearer to the centre than in families
HIGHEST_M = 0.3  # largest height of a place over the table: on seven cubes
STEPS = {"first": 120, "each": 200}  # of the step limit: base, and per object to move


def laid_out(
    said: Sentence, things: Mapping[str, Asset], specs: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Robots, objects, cameras and step_limit of a task. Raises ArgumentError where objects do not fit."""
    _not_too_high(said, things)
    radius_m = BASES_M[said.arms - 1]
    moved = [job.thing for job in said.jobs]
    fixed = [name for name in things if name not in moved]
    # Objects that others are put on form a row in the centre, in front of the bases of two arms.
    objects = {
        name: {**specs[name], "x_m": float((k - (len(fixed) - 1) / 2) * TARGETS_M), "y_m": 0.0}
        for k, name in enumerate(fixed)
    }
    widest_m, off_m = max(_half_m(things[name]) for name in moved), 2 * JITTER_M
    room_m = max(_half_m(things[name]) for name in fixed) + widest_m + APART_M + off_m if fixed else 0.0
    around_m = room_m + TARGETS_M * (len(fixed) - 1) / 2
    # One arm reaches the half of the circle in front of it.
    span = np.pi if said.arms == 1 else 2 * np.pi
    first = -np.pi + np.pi / (2 * len(moved)) if said.arms == 1 else circle.angle_rad(1, 1) + np.pi / 4
    angles = first + span * np.arange(len(moved)) / len(moved)
    wide_m = 2 * widest_m + APART_M + off_m
    if len(moved) > 1:
        around_m = max(around_m, wide_m / 2 / np.sin(span / len(moved) / 2))
    bases = np.array([[robot["x_m"], robot["y_m"]] for robot in circle.robots(said.arms, radius_m)])
    for name, angle in zip(moved, angles, strict=True):
        x_m, y_m = float(around_m * np.cos(angle)), float(around_m * np.sin(angle))
        away_m = float(np.linalg.norm(bases - (x_m, y_m), axis=1).min())
        if away_m > REACHED_M:
            middle = ", ".join(fixed) or "the middle"
            raise ArgumentError(
                f"{len(moved)} things to move do not fit round {middle}: {name} would be {away_m:.2f} m from "
                f"the nearest of {said.arms} arms, which reach {REACHED_M} m; use fewer things or more arms"
            )
        x_m, y_m = round(x_m, 3), round(y_m, 3)
        ranges = {"x_m": [x_m - JITTER_M, x_m + JITTER_M], "y_m": [y_m - JITTER_M, y_m + JITTER_M]}
        objects[name] = {**specs[name], **ranges, "yaw_deg": [-180, 180]}
    limit = STEPS["first"] + STEPS["each"] * len(moved)
    seen = circle.cameras(said.arms, radius_m)
    own = {name: {**camera, "fov_deg": FOV_DEG} for name, camera in seen.items() if name != "global"}
    layout = {"robots": circle.robots(said.arms, radius_m), "cameras": {**seen, **own}}
    return {**layout, "objects": objects, "step_limit": limit}


def _not_too_high(said: Sentence, things: Mapping[str, Asset]) -> None:
    """Raises ArgumentError for an object that would be put higher than HIGHEST_M."""
    tops_m: dict[str, float] = {}
    for job in said.jobs:
        point = things[job.target].points[job.point].object_from_tcp
        tops_m[job.thing] = tops_m.get(job.target, 0.0) + float(point[2, 3])
        if tops_m[job.thing] > HIGHEST_M:
            raise ArgumentError(
                f"{job.thing} would stand {tops_m[job.thing]:.2f} m over the table; arms build up to "
                f"{HIGHEST_M} m"
            )


def _half_m(asset: Asset) -> float:
    """Upper bound on half the width of an asset, seen from above."""
    return float(np.linalg.norm(np.abs(asset.bounds_m[:, :2]).max(axis=0)))
