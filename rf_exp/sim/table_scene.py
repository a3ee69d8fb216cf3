"""The table, the floor and the light: the same for every task, for generation and evaluation."""

from functools import cache

import numpy as np
from mani_skill.envs.scene import ManiSkillScene

from rf_exp.sim import objects
from rf_exp.tasks import TABLE_CENTRE_M, TABLE_M
from rf_exp.tasks.assets import Asset, Part
from rf_exp.transforms import planar, transform

FLOOR_Z_M = -0.75
WALL_M = 3.5  # from the middle of the room
WOOD, LEG, FLOOR, WALL = (0.50, 0.37, 0.25), (0.12, 0.12, 0.13), (0.30, 0.31, 0.32), (0.42, 0.48, 0.54)
LAMP, FILL, AMBIENT = 1.6, 0.6, 0.3


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


def build_table_scene(scene: ManiSkillScene) -> None:
    """Table and floor."""
    objects.build(scene, "table", *_table(), transform())


def light_table_scene(scene: ManiSkillScene, brightness: float) -> None:
    """A lamp, a weaker one from the other side, and light from everywhere.

    Nothing casts a shadow, in generation as in evaluation: on software Vulkan shadows double the
    price of a picture.
    """
    scene.set_ambient_light([AMBIENT * brightness] * 3)
    scene.add_directional_light([-0.6, 0.4, -1.0], [LAMP * brightness] * 3)
    scene.add_directional_light([0.4, -0.7, -0.5], [FILL * brightness] * 3)
