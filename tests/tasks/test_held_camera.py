"""The goal of the steak: in front of the camera at its final height."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.tasks.shared import held_camera
from tests.conftest import read_task
from tests.scenes import start_scene

PHOTO = read_task("take_photo")


def lifted(height_m: float, held: tuple[str | None, ...] = ("camera", "camera", "steak", None)):
    """A scene with the underside of the camera at a height and the steak at its start."""
    scene = start_scene(PHOTO, 0)
    camera = scene.poses["camera"].copy()
    camera[2, 3] = height_m
    return replace(scene, poses={**scene.poses, "camera": camera}, held=held)


@pytest.mark.parametrize(("height_m", "further_m"), [(0.12, 0.10), (0.19, 0.03), (0.206, 0.0), (0.24, 0.0)])
def test_the_place_in_front_is_on_the_final_optical_axis(height_m, further_m):
    scene = lifted(height_m)
    lifts = [each.height_m for each in held_camera.camera_up(scene, PHOTO)]
    assert lifts == ([pytest.approx(further_m)] * 2 if further_m else [])
    placed = replace(scene, poses={**scene.poses, "steak": held_camera.places(scene, PHOTO)["front"]})
    off_m = np.tan(np.deg2rad(held_camera.aim_deg(placed, PHOTO))) * held_camera.STEAK_DISTANCE_M
    assert off_m == pytest.approx(further_m, abs=1e-6)
    assert bool(held_camera.steak_in_front(placed, PHOTO)) == (further_m > 0.02)


def test_a_camera_that_only_one_arm_holds_is_still_to_be_lifted():
    scene = lifted(0.24, (None, "camera", "steak", None))
    verbs = [(each.agent, each.verb) for each in held_camera.camera_up(scene, PHOTO)]
    assert verbs == [(1, "grasp"), (1, "lift"), (2, "lift")]
