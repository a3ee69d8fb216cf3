"""Fast variants of rigid transforms agree with the general ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.transforms import angle_between_rad, position_and_quaternion, quaternion, transform


@pytest.mark.parametrize("seed", range(4))
def test_the_scalar_and_the_array_quaternion_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotations = [
        *Rotation.random(200, rng=rng),
        *Rotation.from_euler("xyz", np.pi * np.eye(3)),
        Rotation.identity(),
    ]
    for rotation in rotations:
        pose = transform(rng.normal(size=3), rotation)
        result = np.array(position_and_quaternion(pose))
        np.testing.assert_array_equal(result[:3], pose[:3, 3])
        np.testing.assert_allclose(result[3:], quaternion(pose), atol=1e-12)


def test_the_angle_between_directions() -> None:
    rng = np.random.default_rng(0)
    for a, b in rng.normal(size=(200, 2, 3)):
        expected = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        assert angle_between_rad(a, b) == pytest.approx(expected, abs=1e-12)
    assert (
        angle_between_rad((0, 0, 1), (0, 0, -1)) == np.pi and angle_between_rad((1, 0, 0), (2, 0, 0)) == 0.0
    )
