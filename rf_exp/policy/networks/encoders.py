"""Encoders trained with the head: the paper's ResNet-18 with GroupNorm, and a compact one for CPUs.

Neither uses pretrained weights.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.networks.interfaces import Encoder

CHANNELS_PER_GROUP = 16  # of ResNet-18's GroupNorm (Diffusion Policy)


def _norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(channels // CHANNELS_PER_GROUP, channels)


def _conv(inputs: int, outputs: int, kernel: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2, bias=False)


class BasicBlock(nn.Module):
    """ResNet's block of two 3x3 convolutions (He et al. 2016) with GroupNorm (Wu and He 2018)."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1, self.norm1 = _conv(inputs, outputs, 3, stride), _norm(outputs)
        self.conv2, self.norm2 = _conv(outputs, outputs, 3), _norm(outputs)
        self.skip: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.skip = nn.Sequential(_conv(inputs, outputs, 1, stride), _norm(outputs))

    def forward(self, x: Tensor) -> Tensor:
        hidden = functional.relu(self.norm1(self.conv1(x)))
        return functional.relu(self.norm2(self.conv2(hidden)) + self.skip(x))


class _Layers(Encoder):
    """Encoder that applies the given layers."""

    def __init__(self, layers: nn.Module) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, pictures: Tensor) -> Tensor:
        return self.layers(pictures)


class ResNet18(_Layers):
    """ResNet-18 from scratch with GroupNorm and without its classifier: 11,176,512 parameters."""

    features = 512

    def __init__(self, *_: Any) -> None:
        stages = [(64, 64, 1), (64, 128, 2), (128, 256, 2), (256, 512, 2)]
        stem = nn.Sequential(_conv(3, 64, 7, 2), _norm(64), nn.ReLU(), nn.MaxPool2d(3, 2, padding=1))
        blocks = (nn.Sequential(BasicBlock(a, b, stride), BasicBlock(b, b, 1)) for a, b, stride in stages)
        super().__init__(nn.Sequential(stem, *blocks, nn.AdaptiveAvgPool2d(1), nn.Flatten()))


class SpatialSoftmax(nn.Module):
    """Expected picture coordinates of each channel (Levine et al. 2016): (B, C, H, W) -> (B, 2C)."""

    def forward(self, x: Tensor) -> Tensor:
        _, _, height, width = x.shape
        attention = x.flatten(2).softmax(dim=2)
        rows = torch.linspace(-1.0, 1.0, height, device=x.device, dtype=x.dtype)
        columns = torch.linspace(-1.0, 1.0, width, device=x.device, dtype=x.dtype)
        grid = torch.cartesian_prod(rows, columns)  # (H * W, 2)
        return (attention @ grid).flatten(1)


class Compact(_Layers):
    """Compact encoder: three small convolutions and a spatial softmax, at a hundredth of ResNet's cost.

    The first convolution has a stride of 4: larger maps would take most of the time, and the softmax locates
    features between cells.
    """

    features = 64

    def __init__(self, *_: Any) -> None:
        def layer(inputs: int, kernel: int, stride: int) -> nn.Sequential:
            return nn.Sequential(_conv(inputs, 32, kernel, stride), nn.GroupNorm(4, 32), nn.ReLU())

        convolutions = layer(3, 8, 4), layer(32, 3, 1), layer(32, 3, 1)
        readout = nn.Conv2d(32, 32, 1), SpatialSoftmax(), nn.Linear(64, self.features)
        super().__init__(nn.Sequential(*convolutions, *readout))
