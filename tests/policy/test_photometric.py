"""Photometric augmentation: each picture gets its own, within the given strength."""

import numpy as np
import torch

from rf_exp.policy.inputs.pictures import scaled
from rf_exp.policy.networks.keypoint_encoder import photometric_augmentation

PICTURES = torch.randint(
    13, 217, (64, 8, 12, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
)


def test_each_picture_is_augmented_differently_and_stays_in_range() -> None:
    augmented, usual = photometric_augmentation(PICTURES, 1.0, np.random.default_rng(0)), scaled(PICTURES)
    assert augmented.shape == usual.shape and augmented.dtype == usual.dtype
    assert augmented.is_contiguous(memory_format=torch.channels_last)
    assert augmented.min() >= -1 and augmented.max() <= 1 and torch.isfinite(augmented).all()
    brightness = ((augmented + 1).mean(dim=(1, 2, 3)) / (usual + 1).mean(dim=(1, 2, 3))).numpy()
    assert brightness.min() < 0.55 and brightness.max() > 1.35 and len(np.unique(brightness)) > 60
    channels = (augmented + 1).mean(dim=(2, 3))
    assert (channels.amax(dim=1) / channels.amin(dim=1)).max() > 1.3


def test_strength_zero_changes_nothing_and_the_generator_decides() -> None:
    same = photometric_augmentation(PICTURES, 0.0, np.random.default_rng(0))
    torch.testing.assert_close(same, scaled(PICTURES), atol=1e-6, rtol=0)
    one, again = (photometric_augmentation(PICTURES, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert torch.equal(one, again) and not torch.equal(
        one, photometric_augmentation(PICTURES, 1.0, np.random.default_rng(4))
    )


def test_brighter_greys_stay_brighter() -> None:
    """For greys, the map of a channel is monotonic, also after mixing: its pixels keep their order."""
    ramp = torch.arange(0, 128, dtype=torch.uint8)[None, None, :, None].expand(1, 1, -1, 3).contiguous()
    augmented = photometric_augmentation(ramp, 1.0, np.random.default_rng(1))
    assert (augmented.diff(dim=3) >= 0).all()
