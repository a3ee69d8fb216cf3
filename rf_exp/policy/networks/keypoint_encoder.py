"""The keypoint encoder: one heat map for each keypoint, read to millimetres.

A small convolutional trunk keeps the resolution of a quarter of the picture; each keypoint has a map over its
cells, learned by the cross entropy to where the keypoint is (Tompson et al. 2014). The middle of a map's peak
is a picture coordinate finer than a cell. Cameras stand still, so that the point in the base frame of the arm
is a smooth function of it: a polynomial, fitted to the labels in closed form once the maps are learned.
"""

from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.config import CELL, KeypointsConfig
from rf_exp.policy.examples.keypoints import HAND, HEADING
from rf_exp.policy.inputs.observation_spec import ObservationSpec, near, of_agent
from rf_exp.policy.inputs.view import View
from rf_exp.policy.networks.crop_refinement import CropRefinement
from rf_exp.policy.networks.interfaces import Draw, Encoder, Fit
from rf_exp.policy.networks.layers import inside_picture, scaled
from rf_exp.policy.networks.photometric import relit

if TYPE_CHECKING:
    from rf_exp.policy.examples.windows import Windows

CHANNELS = 32
POOLED = 32  # numbers that describe what is seen at a keypoint
PEAK = 5  # cells, side of the square round the largest one whose middle is taken
# Of a keypoint: TCP (m), other points as seen from it (m), where all are in the picture, heading, how sure.
# What moves through the room, as another arm does, has a place in the picture to half a pixel, but no point.
PLACED = (3 + 2) * len(HAND)
OUT = PLACED + HEADING + 1
NEXT = OUT + 3 + 3  # numbers that say where an own arm goes next
PIXEL_WEIGHT, HEADING_WEIGHT = 0.05, 1.0  # of the parts of the loss beside the cross entropies
TERMS = 10  # of a polynomial of third degree in two variables
RIDGE = 1e-6


class _Dilated(nn.Module):
    """A residual 3x3 convolution whose taps lie `apart` cells apart."""

    def __init__(self, apart: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(CHANNELS, CHANNELS, 3, padding=apart, dilation=apart, bias=False)
        self.norm = nn.GroupNorm(4, CHANNELS)

    def forward(self, x: Tensor) -> Tensor:
        return x + functional.relu(self.norm(self.conv(x)))


class _Each(nn.Module):
    """A small network with a linear path beside it for each of M keypoints: (B, M, I) -> (B, M, O)."""

    def __init__(self, keypoints: int, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()

        def layer(size: int, out: int) -> nn.Module:
            return nn.Conv1d(keypoints * size, keypoints * out, 1, groups=keypoints)

        self.bent = nn.Sequential(layer(inputs, hidden), nn.Mish(), layer(hidden, outputs))
        self.straight = layer(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        flat = x.flatten(1)[..., None]
        return (self.bent(flat) + self.straight(flat)).reshape(*x.shape[:2], -1)


class KeypointEncoder(Encoder):
    """Pictures (B, 3, H, W) in [-1, 1] -> features (B, M * OUT + N * S).

    Of M keypoints, each P = len(HAND) points: of each own agent at its keyframes, and of the others now. And
    of each of N others how likely it is at each of S subgoals.
    """

    lift: Tensor  # (M * P, TERMS, 3) m

    def __init__(self, config: KeypointsConfig, view: View, spec: ObservationSpec) -> None:
        super().__init__()
        self._config, self._keyframes = config, spec.keyframes
        self._agents = len(view.streams[0].agents)
        self._others, subgoals = len(spec.bases) - self._agents, spec.subgoals
        self.keypoints = keypoints = spec.keypoints(view)
        self.features = keypoints * OUT + self._others * subgoals
        self.trunk = nn.Sequential(
            nn.Conv2d(3, CHANNELS, 2 * CELL, CELL, padding=CELL // 2, bias=False),
            nn.GroupNorm(4, CHANNELS),
            nn.ReLU(),
            *(_Dilated(apart) for apart in (1, 2, 4)),
        )
        self.maps = nn.Conv2d(CHANNELS, keypoints * len(HAND), 1)
        self.pool = nn.Linear(CHANNELS, POOLED)
        self.register_buffer("lift", torch.zeros(keypoints * len(HAND), TERMS, 3))
        self.turn = _Each(keypoints, POOLED, 32, HEADING)
        # Who is done looks like who has not begun; what it has left behind does not.
        self.tell: nn.Module | None = None
        if watched := self._others * subgoals:
            self.tell = nn.Sequential(
                nn.Linear(keypoints * POOLED + CHANNELS, 64), nn.Mish(), nn.Linear(64, watched)
            )
        side = config.crop_refinement
        self.crop_refinement = CropRefinement(keypoints * len(HAND), side) if side else None

    @property
    def size(self) -> int:
        return self.features + self._agents * NEXT

    def fit(self, examples: "Windows") -> Fit | None:
        config = self._config
        if not config.steps:
            return None

        def loss(draw: Draw) -> Tensor:
            pictures, *labels = examples.labelled(draw.windows, config.shift_px, draw.rng)
            seen = scaled(pictures)
            seen = relit(seen, config.photometric, draw.rng) if config.photometric else seen
            return self.loss(seen, *labels)

        settle = partial(self.fit_cameras, examples.pixels, examples.points)
        decides = {key: value for key, value in asdict(config).items() if key != "noise"}
        return Fit([self], loss, config.steps, config.rate, settle, decides)

    def look(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """The maps (B, M * P, h, w), as logits, and what is seen in each cell (B, C, h, w)."""
        if self._config.downsample > 1:
            pictures = functional.avg_pool2d(pictures, self._config.downsample)
        seen = self.trunk(pictures)
        return self.maps(seen), seen

    def read(self, maps: Tensor, seen: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Places in the picture (B, M * P, 2) from 0 to 1, headings (B, M, HEADING), trust (B, M).

        And of each other agent, as logits, the subgoal that it is at (B, N, S).
        """
        chance = maps.flatten(2).softmax(dim=2).unflatten(2, maps.shape[2:])
        near = _peaks(chance)
        total = near.sum(dim=(2, 3))
        rows, columns = (torch.arange(size, device=maps.device) + 0.5 for size in maps.shape[2:])
        y = (near.sum(dim=3) @ rows) / total / maps.shape[2]
        x = (near.sum(dim=2) @ columns) / total / maps.shape[3]
        weights = (near / total[..., None, None]).flatten(2)[:, :: len(HAND)]
        # As the trunk's memory lies: seen otherwise, each of its gradients would be transposed on its way.
        cells = seen.permute(0, 2, 3, 1).flatten(1, 2)  # (B, h * w, C)
        pooled = self.pool(weights @ cells)  # (B, M, POOLED), at the TCPs
        doing = maps.new_zeros(len(maps), 0, 0)
        if self.tell is not None:
            doing = self.tell(torch.cat([pooled.flatten(1), cells.mean(dim=1)], dim=1))
            doing = doing.unflatten(1, (self._others, -1))
        return torch.stack([x, y], dim=2), self.turn(pooled), total[:, :: len(HAND)], doing

    def fit_cameras(self, pixels: Tensor, points: Tensor) -> None:
        """Lift places (N, M * P, 2) to points (N, M * P, 3) in m, by least squares; NaN is left out."""
        for key in range(len(self.lift)):
            seen = inside_picture(pixels[:, key])
            terms, targets = _terms(pixels[seen, key]).double(), points[seen, key].double()
            normal = terms.T @ terms + RIDGE * max(1, len(terms)) * torch.eye(TERMS, device=terms.device)
            self.lift[key] = torch.linalg.solve(normal, terms.T @ targets).float()

    def see(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, F), and the places of the TCPs in the pictures (B, M, 2), from 0 to 1."""
        places, headings, sure, doing = self.read(*self.look(pictures))
        if self.crop_refinement is not None:
            places = self.crop_refinement(pictures, places)
        points = torch.einsum("bkt,ktc->bkc", _terms(places), self.lift).unflatten(1, (-1, len(HAND)))
        tcp = points[:, :, :1]
        hands = torch.cat([tcp, points[:, :, 1:] - tcp], dim=2).flatten(2)
        where = places.unflatten(1, (-1, len(HAND))).flatten(2)
        features = torch.cat([hands, where, headings, sure[..., None]], dim=2)
        features = torch.cat([features.flatten(1), doing.softmax(dim=2).flatten(1)], dim=1)
        return features, places[:, :: len(HAND)]

    def forward(self, pictures: Tensor) -> Tensor:
        return self.see(pictures)[0]

    def loss(self, pictures: Tensor, pixels: Tensor, headings: Tensor, doing: Tensor) -> Tensor:
        """Of pictures whose keypoints are at `pixels` (B, M * P, 2) and head so; NaN is not seen.

        `doing` (B, N) are the subgoals of the others.
        """
        maps, seen = self.look(pictures)
        found, turned, _, told = self.read(maps, seen)
        inside = inside_picture(pixels)
        if not inside.any():
            return maps.sum() * 0.0
        cross = _cross_entropy(maps[inside], pixels[inside])
        off = (found - pixels)[inside].abs().mean() * maps.shape[3]
        hands = inside[:, :: len(HAND)]
        turn = (turned - headings)[hands].abs().sum() / (HEADING * hands.sum().clamp(min=1))
        loss = cross + PIXEL_WEIGHT * off + HEADING_WEIGHT * turn
        if self.crop_refinement is not None:
            loss = loss + PIXEL_WEIGHT * self.crop_refinement.loss(pictures, found, pixels)
        return loss if self.tell is None else loss + functional.cross_entropy(told.mT, doing)

    def perturbed(self, features: Tensor, generator: torch.Generator) -> Tensor:
        """With noise on the places of keypoints, one draw for all frames of a window."""
        if not self._config.noise:
            return features
        shape = len(features), 1, self.keypoints, PLACED
        shift = torch.randn(shape, generator=generator, device=features.device)
        shift = self._config.noise * functional.pad(shift, (0, OUT - PLACED)).flatten(2)
        return features + functional.pad(shift, (0, features.shape[2] - shift.shape[2]))

    def conditioning(self, features: Tensor, context: Tensor) -> Tensor:
        """What is seen, and where each own arm goes next, also from its TCP.

        And that once more where it is near: scaled to a range over the whole table, millimetres are lost.
        """
        keypoints = features[..., : self.keypoints * OUT].unflatten(2, (-1, OUT))
        parts, count = [features], self._keyframes + 1
        for agent in range(self._agents):
            tcp, changes = of_agent(context, agent)
            now = functional.one_hot(changes.argmax(dim=2).clamp(max=self._keyframes), count)
            own = keypoints[:, :, agent * count : (agent + 1) * count]
            ahead = (own * now[..., None]).sum(dim=2)
            offset = ahead[..., :3] - tcp[..., :3]
            parts += [ahead, offset, near(offset)]
        return torch.cat(parts, dim=2)


def _terms(pixels: Tensor) -> Tensor:
    """Places (..., 2) from 0 to 1 -> the terms of a polynomial of third degree (..., TERMS)."""
    x, y = (2 * pixels - 1).unbind(dim=-1)
    one = torch.ones_like(x)
    return torch.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], dim=-1)


def _peaks(chance: Tensor) -> Tensor:
    """Maps (B, M, h, w) with all but the PEAK x PEAK cells round the largest one set to zero."""
    height, width = chance.shape[2:]
    best = chance.flatten(2).argmax(dim=2)
    row, column = best // width, best % width
    rows, columns = (torch.arange(size, device=chance.device) for size in (height, width))
    near_row = (rows - row[..., None]).abs() <= PEAK // 2
    near_column = (columns - column[..., None]).abs() <= PEAK // 2
    return chance * (near_row[..., :, None] & near_column[..., None, :])


def _cross_entropy(maps: Tensor, pixels: Tensor) -> Tensor:
    """Of maps (K, h, w) to places (K, 2) from 0 to 1, each spread over the four nearest cells."""
    height, width = maps.shape[1:]
    logs = maps.flatten(1).log_softmax(dim=1)
    x = (pixels[:, 0] * width - 0.5).clamp(0, width - 1)
    y = (pixels[:, 1] * height - 0.5).clamp(0, height - 1)
    left, top = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    total = maps.new_zeros(len(maps))
    for dx in (0, 1):
        for dy in (0, 1):
            share = (1 - (x - left - dx).abs()) * (1 - (y - top - dy).abs())
            cell = ((top + dy) * width + left + dx).long()
            total = total - share * logs.gather(1, cell[:, None])[:, 0]
    return total.mean()
