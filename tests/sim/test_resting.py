"""Stacked objects rest: the physics engine reports no spurious contacts."""

import numpy as np
import pytest
import sapien
from sapien import physx

from rf_exp.sim.environment import CONTACT_OFFSET_M
from rf_exp.sim.objects import AssetBuilder, sapien_pose
from rf_exp.tasks import assets
from rf_exp.tasks.assets import lid
from rf_exp.transforms import planar

PLACEMENTS = 1000
DEEPEST_M = 0.002


def body(scene: sapien.Scene, name: str) -> sapien.Entity:
    asset = assets.load(name)
    builder = AssetBuilder(asset, (), np.ones(3), asset.mass_kg)
    builder.name = name
    entity = sapien.Entity()
    entity.add_component(builder.build_physx_component())
    scene.add_entity(entity)
    return entity


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lower", "upper", "height_m"),
    [("pot", "lid", lid.SEAT_Z_M), ("cube", "cube", 0.04)],
    ids=["lid on pot", "cube on cube"],
)
def test_contacts_of_stacked_objects_are_shallow(lower: str, upper: str, height_m: float) -> None:
    """With edges of two shapes at one height, PhysX may report contacts 10 cm deep and throw the objects."""
    physx.set_shape_config(contact_offset=CONTACT_OFFSET_M, rest_offset=0)
    system = physx.PhysxCpuSystem()
    scene = sapien.Scene([system])
    scene.set_timestep(0.01)
    below, above = (body(scene, name) for name in (lower, upper))
    rng, deepest_m = np.random.default_rng(0), 0.0
    for _ in range(PLACEMENTS):
        x_m, y_m = rng.uniform(-0.2, 0.2, 2)
        dx_m, dy_m = rng.uniform(-1e-3, 1e-3, 2)
        yaws_rad = rng.uniform(0, 2 * np.pi, 2)
        below.set_pose(sapien_pose(planar(x_m, y_m, yaws_rad[0])))
        above.set_pose(sapien_pose(planar(x_m + dx_m, y_m + dy_m, yaws_rad[1], height_m)))
        system.step()
        deepest_m = min([deepest_m, *(p.separation for c in system.get_contacts() for p in c.points)])
    assert -DEEPEST_M < deepest_m < 0
