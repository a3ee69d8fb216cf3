"""The table, the floor and the light: the same for every task, but for what covers and lights them."""

from functools import cache

import numpy as np
from mani_skill.envs.scene import ManiSkillScene

from rf_exp.sim import objects
from rf_exp.tasks import TABLE_CENTRE_M, TABLE_M
from rf_exp.tasks.assets import Asset, Part
from rf_exp.transforms import planar, transform
from rf_exp.types import BARE, Light, Look

FLOOR_Z_M = -0.75
WALL_M = 3.5  # from the middle of the room
WOOD, LEG, FLOOR, WALL = (0.50, 0.37, 0.25), (0.12, 0.12, 0.13), (0.30, 0.31, 0.32), (0.42, 0.48, 0.54)


@cache
def _table() -> tuple[Asset, tuple[objects.Surface, ...]]:
    """A table large enough for every arm of every task, and the floor below."""
    x, y, thick = np.array(TABLE_M) / 2
    cx, cy = TABLE_CENTRE_M
    leg = (-FLOOR_Z_M - 2 * thick) / 2
    legs = [
        Part.box(
            (0.04, 0.04, leg), transform((cx + sx * (x - 0.1), cy + sy * (y - 0.1), FLOOR_Z_M + leg)), LEG
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    floor = Part.box((WALL_M, WALL_M, 0.05), transform((0, 0, FLOOR_Z_M - 0.05)), FLOOR)
    walls = [
        Part.box((0.05, WALL_M, 1.5), turn @ transform((WALL_M, 0, FLOOR_Z_M + 1.5)), WALL, solid=False)
        for turn in (planar(0, 0, quarter * np.pi / 2) for quarter in range(4))
    ]
    top = Part.box((x, y, thick), transform((cx, cy, -thick)), WOOD)
    asset = Asset("table", parts=(top, *legs, floor, *walls), static=True)
    return asset, objects.surfaces(asset)


def build_table_scene(scene: ManiSkillScene, look: Look) -> None:
    """Table and floor, covered as `look` says."""
    asset, seen = _table()
    finishes = {WOOD: look.table, FLOOR: look.floor, WALL: look.walls}
    covered = [objects.covered((surface,), finishes.get(surface.colour, BARE)) for surface in seen]
    objects.build(scene, "table", asset, sum(covered, ()), transform())


def light_table_scene(scene: ManiSkillScene, light: Light) -> None:
    """Lamps, and light from everywhere.

    Nothing casts a shadow, in generation as in evaluation: on software Vulkan shadows double the
    price of a picture.
    """
    scene.set_ambient_light(list(light.ambient))
    for lamp in light.lamps:
        scene.add_directional_light(list(lamp.direction), list(lamp.colour))
