"""Procedural textures: seamlessly repeating images, a pure function of kind, set and random numbers.

The two sets differ in two ways. For each kind, their palettes differ by more than the random brightness of
a texture, and no pattern repeats as often along a side in one set as in the other.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rf_exp.types import Texture, TextureKind, TextureSet

SIZE_PX = 256
# Ground and figure colours, sRGB: planks and grain, tiles and grout, cloth and checks, clouds, stripes.
PALETTES: dict[TextureSet, dict[TextureKind, tuple[str, ...]]] = {
    "seen": {
        "wood": ("8a5f3c 5e3d24", "b98d5d 8d6238", "6e4a38 4a2f24", "a08468 7b6049", "c9a67a a67f52"),
        "tile": ("b7b2a6 7d786e", "7f95a6 c9ced1", "a5735a d3c3b4", "6f8a72 b9c4b2", "8d8a92 c4c2c8"),
        "cloth": ("c8c2b4 4f6d8f", "b9a58c 7c3f3a", "cfcac4 6b7a4f", "8d99a8 3f4a5c", "c4b0b8 6d4a66"),
        "noise": ("a8a196 6f6a63", "8c9a8a 5f6f62", "9a8579 6b564c", "8793a3 5b6778", "b8ab8f 84795f"),
        "stripes": ("b9b3a7 6f8299", "a9968a 6b4f47", "9aa58f 5c6b55", "c2b6a2 a07d4e", "a3a3ad 5d5d6c"),
    },
    "unseen": {
        "wood": ("9c4f35 6f3322", "d8c3a0 b59b74", "7d7a76 57534f", "6b6a34 47461f", "b07f86 80545c"),
        "tile": ("c4a35f e0d4b4", "5d6f8f 9aa6bd", "a08fa6 6a5b70", "4f7f7d a9c6c3", "b9cf9e 75905a"),
        "cloth": ("c9b77a 8a6a24", "9cc0bd 2f6a6a", "b98a8a 5a2f4a", "a9b58f 2f4f3f", "a39a8d 3a3632"),
        "noise": ("a88a5c 6f5330", "7f9fa6 48707a", "9d7f97 684d66", "a3a86f 6b7040", "6f6c6a 403e3d"),
        "stripes": ("c9b06a 7d6a3a", "7fa6a3 3f6f6d", "b07f8f 6d4256", "8fae6f c9d3a8", "7a86b5 474f85"),
    },
}
REPEATS: dict[TextureSet, tuple[int, ...]] = {"seen": (4, 6, 8), "unseen": (3, 5, 7)}
BRIGHTNESS = 0.06  # half range of the random relative brightness of a texture
THREADS = 64  # per side, of cloth

Field = NDArray[np.float64]  # (S, S), rows and columns


@lru_cache(maxsize=64)
def pixels(texture: Texture) -> NDArray[np.uint8]:
    """The pixels (S, S, 3), sRGB, of a texture; read-only."""
    image = draw(texture.kind, texture.set, np.random.default_rng(texture.seed))
    image.flags.writeable = False
    return image


def draw(
    kind: TextureKind, texture_set: TextureSet, rng: np.random.Generator, size_px: int = SIZE_PX
) -> NDArray[np.uint8]:
    """A random texture (S, S, 3), sRGB, from a palette and pattern of the set; repeats in both directions."""
    ground, figure = (bytes.fromhex(colour) for colour in rng.choice(PALETTES[texture_set][kind]).split())
    brightness = 1 + rng.uniform(-BRIGHTNESS, BRIGHTNESS)
    mix, shade = PATTERNS[kind](rng, int(rng.choice(REPEATS[texture_set])), size_px)
    mix, shade = np.clip(mix, 0, 1), brightness * shade
    channels = [(a + (b - a) * mix) * shade for a, b in zip(ground, figure, strict=True)]  # red, green, blue
    return np.stack([np.clip(np.rint(channel), 0, 255).astype(np.uint8) for channel in channels], axis=-1)


# Each pattern returns the share of the figure colour in [0, 1] and the brightness, about 1, of each pixel.


def _wood(rng: np.random.Generator, repeats: int, size_px: int) -> tuple[Field, Field]:
    """Horizontal planks of different shades, each with a joint at a random place."""
    down, across = _coordinates(size_px)
    plank = (down * repeats).astype(int)
    shifted = (across + rng.uniform(size=repeats)[plank]) % 1.0
    rings = _noise(rng, size_px, 2.0, across_per_down=0.06)
    streaks = _noise(rng, size_px, 0.6, across_per_down=0.03)
    grain = 0.5 + 0.5 * np.sin(2 * np.pi * (2.0 * rings + 3.0 * rng.uniform(size=repeats)[plank]))
    gaps = _line(down * repeats, 2.0 * repeats / size_px) + _line(shifted, 2.0 / size_px)
    shade = (1 + rng.uniform(-0.10, 0.10, repeats)[plank]) * (1 + 0.04 * streaks)
    return 0.65 * grain + 0.12 * streaks, shade * (1 - 0.45 * np.minimum(gaps, 1))


def _tile(rng: np.random.Generator, repeats: int, size_px: int) -> tuple[Field, Field]:
    """Square tiles of slightly different shades, with grout between them."""
    down, across = _coordinates(size_px)
    row, column = (down * repeats).astype(int), (across * repeats).astype(int)
    width = rng.uniform(0.04, 0.09)
    grout = np.maximum(_line(down * repeats, width), _line(across * repeats, width))
    shades = 1 + rng.uniform(-0.08, 0.08, (repeats, repeats))[row, column]
    return grout, np.where(grout > 0.5, 1.0, shades) * (1 + 0.025 * _noise(rng, size_px, 1.2))


def _cloth(rng: np.random.Generator, repeats: int, size_px: int) -> tuple[Field, Field]:
    """Gingham: bands of warp and of weft, in full colour where they cross, in a plain weave."""
    down, across = _coordinates(size_px)
    width = rng.uniform(0.3, 0.6)
    bands = _band(down * repeats, width) + _band(across * repeats, width)
    weave = np.sin(2 * np.pi * THREADS * down) * np.sin(2 * np.pi * THREADS * across)
    return 0.5 * bands, 1 + 0.08 * weave + 0.02 * _noise(rng, size_px, 1.5)


def _stone(rng: np.random.Generator, repeats: int, size_px: int) -> tuple[Field, Field]:
    """Clouds of two colours with fine grain; fewer repeats give larger clouds."""
    clouds = _noise(rng, size_px, 1.8, lowest=repeats / 2)
    return 0.5 + 0.35 * clouds, 1 + 0.03 * _noise(rng, size_px, 0.5)


def _stripes(rng: np.random.Generator, repeats: int, size_px: int) -> tuple[Field, Field]:
    """Stripes, horizontal, vertical or diagonal."""
    down, across = _coordinates(size_px)
    direction = rng.choice([(1, 0), (0, 1), (1, 1), (1, -1)])
    along = repeats * (direction[0] * down + direction[1] * across)
    return _band(along, rng.uniform(0.3, 0.6)), 1 + 0.02 * _noise(rng, size_px, 1.0)


PATTERNS: dict[TextureKind, Callable[[np.random.Generator, int, int], tuple[Field, Field]]] = {
    "wood": _wood,
    "tile": _tile,
    "cloth": _cloth,
    "noise": _stone,
    "stripes": _stripes,
}


def _coordinates(size_px: int) -> tuple[Field, Field]:
    """Row and column coordinates of the pixel centres, in [0, 1)."""
    middles = (np.arange(size_px) + 0.5) / size_px
    down, across = np.meshgrid(middles, middles, indexing="ij")
    return down, across


def _line(along: Field, width: float) -> Field:
    """1 on lines at whole numbers, 0 beside them; soft edges, a quarter of a line wide."""
    distance = np.abs(along - np.rint(along))
    return np.clip((width / 2 - distance) / (width / 4) + 0.5, 0, 1)


def _band(along: Field, width: float) -> Field:
    """1 in bands about whole numbers, 0 beside them; `wide` is their width per distance."""
    return np.clip((width / 2 - np.abs(along - np.rint(along))) * 20 + 0.5, 0, 1)


def _noise(
    rng: np.random.Generator, size_px: int, roll_off: float, across_per_down: float = 1.0, lowest: float = 1.0
) -> Field:
    """Periodic noise of mean 0 and deviation 1; amplitudes fall with frequency to the power of `roll_off`.

    It varies `across_per_down` times as fast along columns as along rows; below `lowest` they are constant.
    """
    spectrum = rng.standard_normal((size_px, size_px // 2 + 1, 2)).view(complex)[..., 0]
    down = np.fft.fftfreq(size_px, 1 / size_px)[:, None]
    across = np.fft.rfftfreq(size_px, 1 / size_px)[None] / across_per_down
    spectrum *= np.maximum(np.hypot(down, across), lowest) ** -roll_off
    spectrum[0, 0] = 0.0
    field = np.fft.irfft2(spectrum, s=(size_px, size_px))
    return field / field.std()
