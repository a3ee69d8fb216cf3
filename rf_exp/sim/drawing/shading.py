"""How pictures are drawn: with shaders that know what our scenes have, and no more.

ManiSkill's `minimal` pack inverts a matrix for every vertex, carries a tangent frame for textures of
normals, looks up an environment and a table of reflections for every pixel, and copies the picture in a pass
of its own. Nothing of that is seen in a scene with textures of colours alone and without surroundings to
mirror: what `shaders/` draws is equal (tests/sim/test_shading.py), but for single pixels that round to the
next of 255 shades. `python benchmarks/render.py` tells what a picture costs. A pack is a folder of GLSL files
that SAPIEN compiles.
"""

import ctypes
from dataclasses import replace
from functools import cache
from pathlib import Path

import sapien
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS, ShaderConfig

SHADERS = Path(__file__).parent / "shaders"
LIKE = "minimal"  # ManiSkill's pack that has the same textures
FORMATS = {"Color": "r8g8b8a8unorm", "PositionSegmentation": "r16g16b16a16sint"}
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h of glibc
KEPT_FREE_BYTES, MAPPED_BYTES = 256 << 20, 32 << 20


def shader_config() -> ShaderConfig:
    """ManiSkill's description of our shaders."""
    return replace(PREBUILT_SHADER_CONFIGS[LIKE], shader_pack=str(SHADERS))


def choose_formats() -> None:
    """What cameras made from now on store; other environments of this process may have changed it."""
    for texture, stored in FORMATS.items():
        sapien.render.set_picture_format(texture, stored)


@cache
def keep_freed_memory() -> None:
    """Lets malloc keep what was freed, for the next picture, where it is glibc's.

    The software driver takes and frees megabytes for every picture. Handed back to the system each time, they
    cost 40 % of a picture's processor time in page faults.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, KEPT_FREE_BYTES)
        mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES)  # or what is larger than 128 KiB would be mapped anew
