"""Self-calibration: the pose of a displaced camera from detections of the gripper, whose pose is known."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.policy import Stream
from rf_exp.policy.acting.self_calibration import CameraEstimate, camera_estimates
from rf_exp.policy.inputs.pictures import rays_of
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import planar, rotation_matrix
from rf_exp.types import Calibration, CameraModel

BASE = planar(0.0, -0.75, np.pi / 2)
EYE = CameraSpec((-0.49, -0.1, 0.66), (0.04, -0.1, 0.07), 43)
USUAL = CameraModel(128, 96, float(np.deg2rad(EYE.fov_deg)), EYE.world_from_camera)
START_M, GOAL_M = np.array([0.615, 0.0, 0.17]), np.array([0.53, 0.05, 0.02])
DETECTIONS, NOISE_PX = 8, 0.7


def rays(camera: CameraModel) -> NDArray[np.float64]:
    found = rays_of(Calibration((BASE,), {"eye": camera}), Stream("eye", (1,)))
    return found[0].astype(float)


def displaced(rng: np.random.Generator) -> CameraModel:
    """The usual camera, displaced by up to 5 cm per axis, 5 degrees, and 3 degrees of its field of view."""
    axis, pose = rng.normal(size=3), USUAL.world_from_camera.copy()
    pose = pose @ rotation_matrix(np.deg2rad(5 * rng.uniform()) * axis / np.linalg.norm(axis))
    pose[:3, 3] += rng.uniform(-0.05, 0.05, 3)
    return replace(USUAL, world_from_camera=pose, fov_y_rad=USUAL.fov_y_rad + np.deg2rad(rng.uniform(-3, 3)))


def project(camera: CameraModel, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place of a point in the picture of a camera, from 0 to 1."""
    seen = rays(camera)
    x, y, z = np.linalg.inv(seen[:, :3]) @ (point - seen[:, 3])
    return np.array([x, y]) / z


def error_m(believed: NDArray[np.float64], camera: CameraModel) -> float:
    """Distance from the goal to where the believed ray through its place in the picture has its height."""
    along = believed[:, :3] @ (*project(camera, GOAL_M), 1.0)
    met = believed[:, 3] + along * (GOAL_M[2] - believed[2, 3]) / along[2]
    return float(np.linalg.norm(met - GOAL_M))


def tracked(camera: CameraModel, rng: np.random.Generator, mistaken: int | None = None) -> CameraEstimate:
    """Estimate from detections of a gripper on its way to the goal; the one of number `mistaken` is wrong."""
    (estimate,) = camera_estimates(rays(USUAL)[None], (128, 96))
    for number in range(DETECTIONS):
        gripper = START_M + (GOAL_M - START_M) * number / (DETECTIONS - 1)
        detected = project(camera, gripper) + rng.normal(0, NOISE_PX, 2) / (128, 96)
        estimate.add_detections(
            gripper[None], np.array([[0.1, 0.9]]) if number == mistaken else detected[None]
        )
    return estimate


def test_a_displaced_camera_is_found() -> None:
    rng, before, after = np.random.default_rng(0), [], []
    for _ in range(20):
        camera = displaced(rng)
        before.append(error_m(rays(USUAL), camera))
        after.append(error_m(tracked(camera, rng).rays, camera))
    assert np.median(before) > 0.03 and np.median(after) < 0.006 and np.quantile(after, 0.9) < 0.012


def test_noise_hardly_moves_the_estimate_of_a_usual_camera() -> None:
    rng = np.random.default_rng(1)
    errors_m = [error_m(tracked(USUAL, rng).rays, USUAL) for _ in range(10)]
    assert np.median(errors_m) < 0.006
    (fresh,) = camera_estimates(rays(USUAL)[None], (128, 96))
    np.testing.assert_allclose(fresh.rays, rays(USUAL), atol=1e-12)


def test_a_single_mistaken_detection_has_little_weight() -> None:
    rng = np.random.default_rng(2)
    errors_m = [
        error_m(tracked(camera, rng, mistaken=3).rays, camera)
        for camera in (displaced(rng) for _ in range(10))
    ]
    assert np.median(errors_m) < 0.01


def test_mistaken_detections_of_a_waiting_gripper_count_once() -> None:
    """Their errors are alike: a long wait adds no information, and used to turn the camera by degrees."""
    rng = np.random.default_rng(3)
    for camera in (displaced(rng) for _ in range(5)):
        estimate = tracked(camera, rng)
        for _ in range(30):
            estimate.add_detections(GOAL_M[None], project(camera, GOAL_M)[None] + 0.08)
        assert error_m(estimate.rays, camera) < 0.015


@pytest.mark.parametrize("row", [0, 1])
def test_each_camera_of_pictures_side_by_side_has_its_part(row: int) -> None:
    """The ray in the middle of its part does not depend on the field of view."""
    cameras = {"one": USUAL, "other": replace(USUAL, fov_y_rad=1.0)}
    usual = rays_of(Calibration((BASE,), cameras), Stream("one", (1,), ("other",))).astype(float)
    estimate = camera_estimates(usual, (128, 96))[row]
    middle = np.array([(row + 0.5) / 2, 0.5, 1.0])
    forward = cameras[("one", "other")[row]].world_from_camera[:3, 2]
    np.testing.assert_allclose(estimate.rays[:, :3] @ middle, BASE[:3, :3].T @ forward, atol=1e-6)
    np.testing.assert_allclose(estimate.centre, middle[:2])
