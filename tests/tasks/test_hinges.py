"""Hinges: poses and angles, their settings in tasks, and their annotations."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets, load_task
from rf_exp.tasks.assets import Asset, Hinge, InteractionPoint, box_lid
from rf_exp.tasks.assets.asset.mesh import HingeSpec
from rf_exp.transforms import planar, transform
from tests.conftest import CONF, read_task

NAME = "three_robots_place_shoes"


@pytest.fixture(scope="module")
def hinge() -> Hinge:
    found = assets.load("box_lid").hinge
    assert found is not None
    return found


@pytest.mark.parametrize("opened_deg", [0.0, 1e-3, 63.0, 90.0, 105.0])
def test_the_hinge_angle_is_the_opening_angle(hinge: Hinge, opened_deg: float) -> None:
    turned = hinge.closed_from_object(np.deg2rad(opened_deg))
    assert np.rad2deg(hinge.angle_rad(turned)) == pytest.approx(opened_deg, abs=1e-9)
    axis = hinge.object_from_hinge[:, 3]
    np.testing.assert_allclose(turned @ axis, axis, atol=1e-12)
    if opened_deg == 90.0:  # the normal of its top points backwards
        np.testing.assert_allclose(turned[:3, 2], [1.0, 0.0, 0.0], atol=1e-12)


def test_arrays_of_angles_give_arrays_of_poses(hinge: Hinge) -> None:
    angles = np.linspace(0.0, 1.5, 6).reshape(2, 3)
    poses = hinge.closed_from_object(angles)
    assert poses.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(hinge.angle_rad(poses), angles, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_lid_starts_open_on_its_box(seed: int) -> None:
    task = read_task(NAME)
    poses = task.start(seed).poses
    assert np.rad2deg(task.hinge_rad("lid", poses)) == pytest.approx(105.0)
    closed = task.hinged_poses("lid", poses, 0.0)
    np.testing.assert_allclose(closed, poses["box"] @ planar(0.0, 0.0, 0.0, box_lid.SHUT_Z_M), atol=1e-12)


def test_a_hinge_is_in_the_digest_and_scales_with_its_asset(hinge: Hinge) -> None:
    lid = assets.load("box_lid")
    other = Asset("box_lid", lid.parts, {}, lid.mass_kg, friction=lid.friction)
    same = Asset("box_lid", lid.parts, {}, lid.mass_kg, friction=lid.friction, hinge=hinge)
    assert other.content_digest != same.content_digest
    larger = lid.scaled(1.2).hinge
    assert larger is not None and larger.open_deg == hinge.open_deg
    scaled_m = hinge.object_from_hinge[:3, 3] * 1.2
    np.testing.assert_allclose(larger.object_from_hinge[:3, 3], scaled_m)


def test_shut_points_need_a_hinge() -> None:
    point = InteractionPoint(transform(), "shut")
    with pytest.raises(ArgumentError, match="point 'back' is to shut door, which has no hinge"):
        Asset("door", (), {"back": point})


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("lid", {"open_deg": 120.0}, "'lid' has open_deg 120; expected 0 to 105"),
        ("lid", {"yaw_deg": [-5, 5]}, "'lid' hangs on 'box' by a hinge; expected single numbers for x_m"),
        ("lid", {"relative_to": None}, "expected relative_to something that is fixed to the table, not None"),
        ("left_shoe", {"open_deg": 10.0}, "'left_shoe' has no hinge, and open_deg 10; leave it out"),
    ],
)
def test_impossible_hinges_are_refused(name: str, change: dict[str, Any], said: str) -> None:
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / f"{NAME}.yaml"))
    node[NAME]["objects"][name] |= change
    with pytest.raises(ArgumentError, match=said):
        load_task(NAME, node[NAME])


def test_a_hinge_can_be_annotated_and_errors_are_reported(hinge: Hinge) -> None:
    spec = HingeSpec.of(hinge)
    restored = spec.hinge()
    assert asdict(HingeSpec.of(restored)) == asdict(spec)
    np.testing.assert_allclose(restored.closed_from_object(0.7), hinge.closed_from_object(0.7), atol=1e-6)
    slanted = HingeSpec((0.0, 0.0, 0.0), 90.0, 30.0, 1.0, 0.1, axis=(0.0, 2.0, 2.0)).hinge()
    np.testing.assert_allclose(slanted.object_from_hinge[:3, 1], np.sqrt([0.0, 0.5, 0.5]), atol=1e-12)
    with pytest.raises(ArgumentError, match=r"axis of the hinge is \(0, 0, 0\)"):
        HingeSpec((0.0, 0.0, 0.0), 90.0, 30.0, 1.0, 0.1, axis=(0.0, 0.0, 0.0)).hinge()
    with pytest.raises(ArgumentError, match="falls_deg 95 and open_deg 90"):
        HingeSpec((0.0, 0.0, 0.0), 90.0, 95.0, 1.0, 0.1).hinge()
