"""Procedural textures: pure, without seams, in two sets that have no palette and no pattern in common."""

from itertools import product
from typing import get_args

import numpy as np
import pytest

from rf_exp.sim.textures import BRIGHTNESS, PALETTES, PATTERNS, REPEATS, SIZE_PX, draw, pixels
from rf_exp.types import Texture, TextureKind, TextureSet

KINDS, SETS = get_args(TextureKind), get_args(TextureSet)
EVERY = pytest.mark.parametrize(("kind", "of"), list(product(KINDS, SETS)))
SEEDS = range(6)
APART = 15  # levels of 255, at least, in some channel
DARKEST, LIGHTEST = (
    50,
    205,
)  # means, of 255: lamps of half and of one and a half their brightness leave something


def drawn(kind: TextureKind, of: TextureSet, seed: int) -> np.ndarray:
    return draw(kind, of, np.random.default_rng(seed))


@EVERY
def test_the_same_random_numbers_give_the_same_bytes(kind: TextureKind, of: TextureSet) -> None:
    first = drawn(kind, of, 0)
    assert first.shape == (SIZE_PX, SIZE_PX, 3) and first.dtype == np.uint8
    np.testing.assert_array_equal(first, drawn(kind, of, 0))
    np.testing.assert_array_equal(first, pixels(Texture(kind, of, 0, 0.5)))
    assert len({drawn(kind, of, seed).tobytes() for seed in SEEDS}) == len(SEEDS)


@EVERY
def test_a_texture_is_neither_dark_nor_glaring_and_shows_a_pattern(kind: TextureKind, of: TextureSet) -> None:
    for seed in SEEDS:
        texture = drawn(kind, of, seed)
        assert DARKEST < texture.mean() < LIGHTEST
        assert 5 < texture.mean(axis=-1).std() < 60


@EVERY
def test_a_texture_goes_on_where_it_begins_anew(kind: TextureKind, of: TextureSet) -> None:
    """The last row and column are no farther from the first than neighbours somewhere within are."""
    for seed in SEEDS:
        texture = drawn(kind, of, seed).astype(float)
        for axis in (0, 1):
            steps = np.abs(np.diff(texture, axis=axis)).mean(axis=(1 - axis, 2))
            seam = np.abs(np.take(texture, 0, axis) - np.take(texture, -1, axis)).mean()
            assert seam <= 1.2 * steps.max(), (seed, axis)


@pytest.mark.parametrize("kind", KINDS)
def test_no_palette_of_a_kind_is_in_both_sets(kind: TextureKind) -> None:
    """However bright: what a texture draws for itself does not take one to the other."""
    widest = (1 + BRIGHTNESS) / (1 - BRIGHTNESS)
    factors = np.linspace(1 / widest, widest, 41)[:, None]
    for seen, unseen in product(PALETTES["seen"][kind], PALETTES["unseen"][kind]):
        one, other = (np.array([*bytes.fromhex(each)], float) for each in (seen, unseen))  # (6,)
        apart = np.abs(factors * one - other).max(axis=1).min()
        assert apart > APART, f"{kind}: {seen} and {unseen} are alike"


def test_no_pattern_repeats_as_often_in_both_sets() -> None:
    assert not set(REPEATS["seen"]) & set(REPEATS["unseen"])
    assert set(PATTERNS) == set(KINDS) and all(set(PALETTES[of]) == set(KINDS) for of in SETS)


def test_pixels_of_a_texture_are_made_once_and_nobody_changes_them() -> None:
    texture = Texture("tile", "seen", 3, 0.4)
    assert pixels(texture) is pixels(Texture("tile", "seen", 3, 0.4))
    with pytest.raises(ValueError, match="read-only"):
        pixels(texture)[0] = 0
