"""Procedural textures: deterministic, seamless, in two sets without a common palette or pattern."""

from itertools import product
from typing import get_args

import numpy as np
import pytest

from rf_exp.sim.textures import BRIGHTNESS, PALETTES, PATTERNS, REPEATS, SIZE_PX, draw, pixels
from rf_exp.types import Texture, TextureKind, TextureSet

KINDS, SETS = get_args(TextureKind), get_args(TextureSet)
ALL_TEXTURES = pytest.mark.parametrize(("kind", "texture_set"), list(product(KINDS, SETS)))
SEEDS = range(6)
MIN_DIFFERENCE = 15  # minimum difference in some channel, of 255
# Range of the mean, of 255: visible with lamps of 0.5 and 1.5 times their brightness.
DARKEST, LIGHTEST = 50, 205


def texture_pixels(kind: TextureKind, texture_set: TextureSet, seed: int) -> np.ndarray:
    return draw(kind, texture_set, np.random.default_rng(seed))


@ALL_TEXTURES
def test_the_same_random_numbers_give_the_same_bytes(kind: TextureKind, texture_set: TextureSet) -> None:
    first = texture_pixels(kind, texture_set, 0)
    assert first.shape == (SIZE_PX, SIZE_PX, 3) and first.dtype == np.uint8
    np.testing.assert_array_equal(first, texture_pixels(kind, texture_set, 0))
    np.testing.assert_array_equal(first, pixels(Texture(kind, texture_set, 0, 0.5)))
    assert len({texture_pixels(kind, texture_set, seed).tobytes() for seed in SEEDS}) == len(SEEDS)


@ALL_TEXTURES
def test_a_texture_has_medium_brightness_and_a_pattern(kind: TextureKind, texture_set: TextureSet) -> None:
    for seed in SEEDS:
        texture = texture_pixels(kind, texture_set, seed)
        assert DARKEST < texture.mean() < LIGHTEST
        assert 5 < texture.mean(axis=-1).std() < 60


@ALL_TEXTURES
def test_a_texture_has_no_seams(kind: TextureKind, texture_set: TextureSet) -> None:
    """Across the seam, pixels differ no more than neighbours inside the texture."""
    for seed in SEEDS:
        texture = texture_pixels(kind, texture_set, seed).astype(float)
        for axis in (0, 1):
            steps = np.abs(np.diff(texture, axis=axis)).mean(axis=(1 - axis, 2))
            seam = np.abs(np.take(texture, 0, axis) - np.take(texture, -1, axis)).mean()
            assert seam <= 1.2 * steps.max(), (seed, axis)


@pytest.mark.parametrize("kind", KINDS)
def test_no_palette_of_a_kind_is_in_both_sets(kind: TextureKind) -> None:
    """At any brightness: the random brightness of a texture does not turn one palette into another."""
    ratio = (1 + BRIGHTNESS) / (1 - BRIGHTNESS)
    factors = np.linspace(1 / ratio, ratio, 41)[:, None]
    for seen, unseen in product(PALETTES["seen"][kind], PALETTES["unseen"][kind]):
        first, second = (np.array([*bytes.fromhex(each)], float) for each in (seen, unseen))  # (6,)
        difference = np.abs(factors * first - second).max(axis=1).min()
        assert difference > MIN_DIFFERENCE, f"{kind}: {seen} and {unseen} are alike"


def test_patterns_repeat_differently_in_both_sets() -> None:
    assert not set(REPEATS["seen"]) & set(REPEATS["unseen"])
    assert set(PATTERNS) == set(KINDS) and all(
        set(PALETTES[texture_set]) == set(KINDS) for texture_set in SETS
    )


def test_pixels_of_a_texture_are_cached_and_read_only() -> None:
    texture = Texture("tile", "seen", 3, 0.4)
    assert pixels(texture) is pixels(Texture("tile", "seen", 3, 0.4))
    with pytest.raises(ValueError, match="read-only"):
        pixels(texture)[0] = 0
