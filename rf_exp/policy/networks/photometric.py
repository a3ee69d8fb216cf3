"""Photometric augmentation: pictures in another light, on which nothing that is learned is to depend."""

import numpy as np
import torch
from torch import Tensor

# Half ranges of logarithms, but for the grey: a pilot with these held from 0.35 to 1.5 times the usual light.
GAIN, CHANNELS, GAMMA, GREY = (-0.7, 0.5), (-0.3, 0.3), (-0.4, 0.4), (0.0, 0.5)


def relit(pictures: Tensor, strength: float, rng: np.random.Generator) -> Tensor:
    """Pictures (B, 3, H, W) in [-1, 1], each otherwise exposed, coloured, contrasted and saturated."""

    def drawn(span: tuple[float, float], channels: int = 1) -> Tensor:
        values = strength * rng.uniform(*span, (len(pictures), channels, 1, 1))
        return torch.from_numpy(values).to(pictures)

    gain, gamma, grey = (drawn(GAIN) + drawn(CHANNELS, 3)).exp(), drawn(GAMMA).exp(), drawn(GREY)
    seen = (pictures + 1) / 2
    seen = torch.lerp(seen, seen.mean(dim=1, keepdim=True), grey)
    return 2 * (gain * seen**gamma).clamp(max=1) - 1
