"""Quick forms of rigid transforms say what the general ones say."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rf_exp.transforms import angle_between_rad, position_and_quaternion, quaternion, transform


@pytest.mark.parametrize("seed", range(4))
def test_one_pose_has_the_quaternion_of_many(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = [
        *Rotation.random(200, rng=rng),
        *Rotation.from_euler("xyz", np.pi * np.eye(3)),
        Rotation.identity(),
    ]
    for turn in turns:
        pose = transform(rng.normal(size=3), turn)
        found = np.array(position_and_quaternion(pose))
        np.testing.assert_array_equal(found[:3], pose[:3, 3])
        np.testing.assert_allclose(found[3:], quaternion(pose), atol=1e-12)


def test_the_angle_between_directions() -> None:
    rng = np.random.default_rng(0)
    for a, b in rng.normal(size=(200, 2, 3)):
        expected = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        assert angle_between_rad(a, b) == pytest.approx(expected, abs=1e-12)
    assert (
        angle_between_rad((0, 0, 1), (0, 0, -1)) == np.pi and angle_between_rad((1, 0, 0), (2, 0, 0)) == 0.0
    )
