"""Parts of networks: hidden layers, scaled pictures, places in a picture."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from torch import Tensor, nn


def scaled(pictures: Tensor) -> Tensor:
    """Pictures (U, h, w, 3) uint8 -> (U, 3, h, w) in [-1, 1]."""
    # Seen with channels in front they are channels_last already: no copy, the fast layout on CPUs.
    return pictures.permute(0, 3, 1, 2).float().div(127.5).sub(1.0)


def inside_picture(places: Tensor) -> Tensor:
    """Which of places (..., 2), from 0 to 1 over a picture, are in it; NaN is not."""
    return ((places >= 0) & (places <= 1)).all(dim=-1)


def hidden(sizes: Sequence[int], dropout: float = 0.0) -> Iterator[nn.Module]:
    """Linear layers between these sizes, each with Mish behind it."""
    for inputs, outputs in pairwise(sizes):
        yield from (nn.Linear(inputs, outputs), nn.Mish())
        if dropout:
            yield nn.Dropout(dropout)
