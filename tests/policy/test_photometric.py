"""Pictures in another light: each in its own, darker or brighter as far as was asked for."""

import numpy as np
import torch

from rf_exp.policy.networks.keypoint_encoder import relit

PICTURES = torch.rand(64, 3, 8, 12, generator=torch.Generator().manual_seed(0)) * 1.6 - 0.9


def test_each_picture_is_lit_otherwise_and_stays_a_picture() -> None:
    seen = relit(PICTURES, 1.0, np.random.default_rng(0))
    assert seen.shape == PICTURES.shape and seen.dtype == PICTURES.dtype
    assert seen.min() >= -1 and seen.max() <= 1 and torch.isfinite(seen).all()
    bright = ((seen + 1).mean(dim=(1, 2, 3)) / (PICTURES + 1).mean(dim=(1, 2, 3))).numpy()
    assert bright.min() < 0.55 and bright.max() > 1.35 and len(np.unique(bright)) > 60
    channels = (seen + 1).mean(dim=(2, 3))
    assert (channels.amax(dim=1) / channels.amin(dim=1)).max() > 1.3


def test_no_strength_changes_nothing_and_the_generator_decides() -> None:
    torch.testing.assert_close(relit(PICTURES, 0.0, np.random.default_rng(0)), PICTURES, atol=1e-6, rtol=0)
    one, again = (relit(PICTURES, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert torch.equal(one, again) and not torch.equal(one, relit(PICTURES, 1.0, np.random.default_rng(4)))


def test_what_is_brighter_in_a_channel_stays_brighter() -> None:
    """Without mixing towards grey each channel is only bent: the order of its pixels stays."""
    ramp = torch.linspace(-1, 0, 50).expand(3, 1, 50)[None]
    seen = relit(ramp, 1.0, np.random.default_rng(1))
    assert (seen.diff(dim=3) >= 0).all()
