"""Pictures in another light: each in its own, darker or brighter as far as was asked for."""

import numpy as np
import torch

from rf_exp.policy.inputs.pictures import scaled
from rf_exp.policy.networks.keypoint_encoder import photometric_augmentation

PICTURES = torch.randint(
    13, 217, (64, 8, 12, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
)


def test_each_picture_is_lit_otherwise_and_stays_a_picture() -> None:
    seen, usual = photometric_augmentation(PICTURES, 1.0, np.random.default_rng(0)), scaled(PICTURES)
    assert seen.shape == usual.shape and seen.dtype == usual.dtype
    assert seen.is_contiguous(memory_format=torch.channels_last)
    assert seen.min() >= -1 and seen.max() <= 1 and torch.isfinite(seen).all()
    bright = ((seen + 1).mean(dim=(1, 2, 3)) / (usual + 1).mean(dim=(1, 2, 3))).numpy()
    assert bright.min() < 0.55 and bright.max() > 1.35 and len(np.unique(bright)) > 60
    channels = (seen + 1).mean(dim=(2, 3))
    assert (channels.amax(dim=1) / channels.amin(dim=1)).max() > 1.3


def test_no_strength_changes_nothing_and_the_generator_decides() -> None:
    same = photometric_augmentation(PICTURES, 0.0, np.random.default_rng(0))
    torch.testing.assert_close(same, scaled(PICTURES), atol=1e-6, rtol=0)
    one, again = (photometric_augmentation(PICTURES, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert torch.equal(one, again) and not torch.equal(
        one, photometric_augmentation(PICTURES, 1.0, np.random.default_rng(4))
    )


def test_what_is_brighter_stays_brighter() -> None:
    """Of greys each channel is only bent, and mixed with the others: the order of its pixels stays."""
    ramp = torch.arange(0, 128, dtype=torch.uint8)[None, None, :, None].expand(1, 1, -1, 3).contiguous()
    seen = photometric_augmentation(ramp, 1.0, np.random.default_rng(1))
    assert (seen.diff(dim=3) >= 0).all()
