"""Crop refinement: a second look at small squares of the whole picture, round what heat maps have found.

Heat maps cover the picture downsampled, so that they are cheap. What they have found to a pixel of that, some
convolutions find to a fraction of a pixel of the whole picture, at the cost of a few small squares.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.networks.layers import inside_picture

WIDE = 16  # channels
STRIDE = 2  # pixels of the picture to a cell of a square
REACH = 0.25  # of a square's side: in training its middle is at most so far from its keypoint


class CropRefinement(nn.Module):
    """Squares of `side` pixels round K places of a picture -> where in them the K points are."""

    def __init__(self, points: int, side: int) -> None:
        super().__init__()
        self._side = side

        def layer(inputs: int, size: int, stride: int = 1, apart: int = 1) -> nn.Sequential:
            return nn.Sequential(
                nn.Conv2d(inputs, WIDE, size, stride, apart * (size // 2), apart, bias=False),
                nn.GroupNorm(4, WIDE),
                nn.ReLU(),
            )

        self.trunk = nn.Sequential(layer(3, 5, STRIDE), layer(WIDE, 3), layer(WIDE, 3, apart=2))
        # Each point has a map of its own: one product of what is seen with K vectors, of which one counts.
        self.points = nn.Parameter(torch.randn(points, WIDE) / WIDE**0.5)

    def forward(self, pictures: Tensor, places: Tensor) -> Tensor:
        """Of pictures (B, 3, H, W), places (B, K, 2) from 0 to 1 -> the places looked at again (B, K, 2)."""
        size = torch.tensor(pictures.shape[:1:-1], device=places.device)  # W, H
        corners = self._corners(places, size)
        maps = self._maps(pictures, corners)
        return self._middles(maps, corners, size)

    def loss(self, pictures: Tensor, places: Tensor, true: Tensor) -> Tensor:
        """How far in pixels the places are off the true ones (B, K, 2), of which NaN counts for nothing."""
        known = inside_picture(true)
        size = torch.tensor(pictures.shape[:1:-1], device=places.device)
        reach = REACH * self._side / size
        true = torch.where(known[..., None], true, places.detach())
        near = true + (places.detach() - true).clamp(-reach, reach)
        off = (self(pictures, near) - true)[known] * size
        return off.abs().mean() if len(off) else places.sum() * 0.0

    def _corners(self, places: Tensor, size: Tensor) -> Tensor:
        """The upper left pixels (B, K, 2) of squares round places that are wholly in the picture."""
        corners = (places.detach() * size - self._side / 2).round().long()
        return corners.clamp_min(0).minimum(size - self._side)

    def _maps(self, pictures: Tensor, corners: Tensor) -> Tensor:
        """The chance of each point to be in each cell of its square: (B, K, h, w)."""
        batch, points = corners.shape[:2]
        along = torch.arange(self._side, device=corners.device)
        columns, rows = (corners[..., axis, None] + along for axis in (0, 1))  # (B, K, s)
        which = torch.arange(batch, device=corners.device)[:, None, None, None]
        squares = pictures.permute(0, 2, 3, 1)[which, rows[..., :, None], columns[..., None, :]]
        seen = self.trunk(squares.flatten(0, 1).permute(0, 3, 1, 2)).unflatten(0, (batch, points))
        maps = torch.einsum("bkchw,kc->bkhw", seen, self.points)
        return functional.softmax(maps.flatten(2), dim=2).view_as(maps)

    def _middles(self, maps: Tensor, corners: Tensor, size: Tensor) -> Tensor:
        """Where in the picture the middles of maps are, from 0 to 1."""
        rows, columns = (
            STRIDE * torch.arange(count, device=maps.device) + 0.5 for count in maps.shape[2:]
        )  # of the pixel at which a kernel stands
        within = torch.stack([maps.sum(dim=2) @ columns, maps.sum(dim=3) @ rows], dim=2)
        return (corners + within) / size
