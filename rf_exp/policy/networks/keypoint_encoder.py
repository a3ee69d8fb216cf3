"""Keypoint encoder: one heat map for each keypoint, which localises it to millimetres.

A small convolutional trunk keeps a quarter of the picture's resolution; each keypoint has a map over its
cells, trained with the cross entropy to the place of the keypoint (Tompson et al. 2014). The centre of a
map's peak is a picture coordinate finer than a cell, and the camera calibration gives its ray. The distance
along the ray follows from the height of the keypoint above the table, which is predicted (an object on a
table is gripped at the same height wherever it lies), and from the ray of a second camera, if there is one. A
camera that has moved loses no accuracy as long as its calibration is known.

To be cheap, heat maps cover the downsampled picture and find keypoints to a pixel of that. Crop refinement
then finds them to a fraction of a pixel of the full picture, in a few small square crops of it.
"""

from dataclasses import asdict, dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.artifacts import without
from rf_exp.policy.config import CELL, LATER, KeypointsConfig
from rf_exp.policy.examples.keypoints import HAND, HEADING
from rf_exp.policy.examples.windows import Labels, Windows
from rf_exp.policy.inputs.observation_spec import ObservationSpec, near, of_agent
from rf_exp.policy.inputs.pictures import inside_picture, scaled
from rf_exp.policy.inputs.view import View
from rf_exp.policy.networks.interfaces import Draw, Encoder, Fit

CHANNELS = 32
POOLED = 32  # features pooled at a keypoint
PEAK = 5  # cells, side of the square around the maximum of a map over which the mean is taken
PLACED = 3 * len(HAND)  # per keypoint: TCP, other points relative to it (m)
OUT = PLACED + HEADING + 1  # with heading and confidence
NEXT = OUT + 3 + 3  # features of the next goal of an own arm: keypoint, offset, clipped offset
# Weights of the loss terms beside the cross entropies.
PIXEL_WEIGHT, HEADING_WEIGHT, HEIGHT_WEIGHT = 0.05, 1.0, 0.2
LEAST_SPREAD_M = 0.005  # least standard deviation that heights are scaled by: less is noise
# Standard deviations of a point: from the ray of a certain detection, and, as a prior, from its mean.
RAY_STD_M, PRIOR_STD_M = 0.005, 0.5
LEAST_ERROR_M = 0.001  # least error of a predicted height
DECAY = 0.99  # decay per batch of the running mean error of heights
# Crop refinement: channels; pixels of the picture per cell of a crop; and the largest offset of a crop from
# its keypoint in training, as a fraction of its side.
WIDE, STRIDE, REACH = 16, 2, 0.25
MIDDLE = 0.5  # offset of the centre of a pixel, on which kernels are centred
# Photometric augmentation: ranges of logarithms, but for the share of grey. A pilot with these held from 0.35
# to 1.5 times the usual light.
GAIN, TINT, GAMMA, GREY = (-0.7, 0.5), (-0.3, 0.3), (-0.4, 0.4), (0.0, 0.5)


class _Dilated(nn.Module):
    """Residual 3x3 convolution with a dilation of `apart` cells."""

    def __init__(self, apart: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(CHANNELS, CHANNELS, 3, padding=apart, dilation=apart, bias=False)
        self.norm = nn.GroupNorm(4, CHANNELS)

    def forward(self, x: Tensor) -> Tensor:
        return x + functional.relu(self.norm(self.conv(x)))


class _Each(nn.Module):
    """Separate small networks with a linear skip path for each of M keypoints: (B, M, I) -> (B, M, O)."""

    def __init__(self, keypoints: int, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()

        def layer(size: int, out: int) -> nn.Module:
            return nn.Conv1d(keypoints * size, keypoints * out, 1, groups=keypoints)

        self.bent = nn.Sequential(layer(inputs, hidden), nn.Mish(), layer(hidden, outputs))
        self.straight = layer(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        flat = x.flatten(1)[..., None]
        return (self.bent(flat) + self.straight(flat)).reshape(*x.shape[:2], -1)


class CropRefinement(nn.Module):
    """Crop refinement: locates K points in square crops of `side` pixels around K coarse places."""

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
        # One vector per point; its map is the product of the vector with the features of its own crop.
        self.points = nn.Parameter(torch.randn(points, WIDE) / WIDE**0.5)

    def forward(self, pictures: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Pictures (B, 3, H, W), places (B, K, 2) from 0 to 1 -> refined places, features (B, K, WIDE)."""
        return self._read(*self._look(pictures, places), _size(pictures))

    def loss(self, pictures: Tensor, places: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """Training loss for the true places (B, K, 2) of the points, and the features there (B, K, WIDE).

        NaN and places outside the picture are ignored. The loss is the error in pixels plus the cross entropy
        of the maps: with the first alone errors are a third larger.
        """
        known, size = inside_picture(true), _size(pictures)
        reach = REACH * self._side / size
        true = torch.where(known[..., None], true, places.detach())
        near = true + (places.detach() - true).clamp(-reach, reach)
        maps, seen, corners = self._look(pictures, near)
        found, there = self._read(maps, seen, corners, size)
        if not known.any():
            return places.sum() * 0.0, there
        off = ((found - true)[known] * size).abs().mean()
        cells = (true * size - corners - MIDDLE) / STRIDE + 0.5
        cross = _cross_entropy(maps[known], cells[known] / cells.new_tensor(maps.shape[:1:-1]))
        return PIXEL_WEIGHT * off + cross, there

    def _look(self, pictures: Tensor, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Maps (B, K, h, w) of crops as logits, features (B, K, WIDE, h, w), upper left corners (B, K, 2)."""
        size = _size(pictures)
        corners = (places.detach() * size - self._side / 2).round().long()
        corners = corners.clamp_min(0).minimum(size - self._side)  # wholly inside the picture
        along = torch.arange(self._side, device=places.device)
        columns, rows = (corners[..., axis, None] + along for axis in (0, 1))  # (B, K, side)
        which = torch.arange(len(places), device=places.device)[:, None, None, None]
        squares = pictures.permute(0, 2, 3, 1)[which, rows[..., :, None], columns[..., None, :]]
        seen = self.trunk(squares.flatten(0, 1).permute(0, 3, 1, 2)).unflatten(0, places.shape[:2])
        return torch.einsum("bkchw,kc->bkhw", seen, self.points), seen, corners

    def _read(self, maps: Tensor, seen: Tensor, corners: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
        """Mean places (B, K, 2) of the maps, from 0 to 1 in the picture, and features there (B, K, WIDE)."""
        maps = functional.softmax(maps.flatten(2), dim=2).view_as(maps)
        there = torch.einsum("bkhw,bkchw->bkc", maps, seen)
        rows, columns = (
            STRIDE * torch.arange(count, device=maps.device) + MIDDLE for count in maps.shape[2:]
        )
        within = torch.stack([maps.sum(dim=2) @ columns, maps.sum(dim=3) @ rows], dim=2)
        return (corners + within) / size, there


@dataclass(frozen=True)
class _Read:
    """Readout of the heat maps of B pictures, for each of K cameras."""

    places: Tensor  # (B, K * M * P, 2) in the picture, from 0 to 1
    rise: Tensor  # (B, K * M * P) heights above their mean, in units of `spread`
    headings: Tensor  # (B, K * M, HEADING)
    sure: Tensor  # (B, K * M) confidence: probability mass of the peak
    scene: Tensor  # (B, K * M * POOLED + CHANNELS) features at the keypoints, and their mean over the picture


class KeypointEncoder(Encoder):
    """Pictures (B, 3, H, W) in [-1, 1] of K cameras side by side -> features (B, M * OUT + N * S).

    M keypoints of P = len(HAND) points each: every own agent at its keyframes and at the end, and all agents
    now; then the probabilities of S subgoals for each of N other agents.
    """

    usual: Tensor  # (S, K, 3, 4) rays of the cameras of S streams, as usually mounted
    centre: Tensor  # (M * P, 3) m, mean of each point, in the footprint of the first own arm
    spread: Tensor  # (M * P,) m, standard deviation of its height
    height_error: Tensor  # (M * P,) m, mean error of predicted heights

    def __init__(self, config: KeypointsConfig, view: View, spec: ObservationSpec) -> None:
        super().__init__()
        self._config, self._keyframes = config, spec.keyframes
        self._agents = len(view.streams[0].agents)
        self._others, subgoals = len(spec.bases) - self._agents, spec.subgoals
        self._cameras = len(view.streams[0].cameras)
        self.keypoints, points = spec.keypoints(view), spec.keypoints(view) * len(HAND)
        self.features = self.keypoints * OUT + self._others * subgoals
        seen = self._cameras * self.keypoints  # one for each camera
        self.trunk = nn.Sequential(
            nn.Conv2d(3, CHANNELS, 2 * CELL, CELL, padding=CELL // 2, bias=False),
            nn.GroupNorm(4, CHANNELS),
            nn.ReLU(),
            *(_Dilated(apart) for apart in config.dilations),
        )
        self.maps = nn.Conv2d(CHANNELS, seen * len(HAND), 1)
        self.pool = nn.Linear(CHANNELS, POOLED)
        self.register_buffer("usual", torch.eye(3, 4).repeat(len(view.streams), self._cameras, 1, 1))
        self.register_buffer("centre", torch.zeros(points, 3))
        self.register_buffer("spread", torch.full((points,), LEAST_SPREAD_M))
        self.register_buffer("height_error", torch.full((points,), LEAST_SPREAD_M))
        self.turn = _Each(seen, POOLED, 32, HEADING)
        self.rise = _Each(seen, POOLED + CHANNELS + 3 + 12, 32, len(HAND))
        # Subgoals of others, from the scene: a finished arm looks as before it began, its work does not.
        self.tell: nn.Module | None = None
        side = config.crop_refinement
        if watched := self._others * subgoals:
            told = POOLED + (WIDE if side else 0)  # for closed fingers, which are a pixel wide
            self.tell = nn.Sequential(
                nn.Linear(seen * told + CHANNELS, 64), nn.Mish(), nn.Linear(64, watched)
            )
        self.crop_refinement = CropRefinement(seen * len(HAND), side) if side else None

    @property
    def size(self) -> int:
        return self.features + self._agents * NEXT

    @property
    def usual_rays(self) -> Tensor:
        return self.usual

    def fit(self, examples: Windows) -> Fit | None:
        config = self._config
        self.fit_points(examples.pixels, examples.points)
        self.usual.copy_(examples.usual_rays)
        if not config.steps:
            return None

        def loss(draw: Draw) -> Tensor:
            pictures, rays, labels = examples.labelled(draw.windows, config.shift_px, draw.rng)
            light = config.photometric
            seen = relit(pictures, light, draw.rng) if light else scaled(pictures)
            return self.loss(seen, rays, labels)

        decides = without(asdict(config), **LATER["encoder"]["keypoints"])
        decides.pop("noise")
        return Fit([self], loss, config.steps, config.rate, shared=decides)

    def look(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Heat maps (B, K * M * P, h, w), as logits, and the features of each cell (B, C, h, w)."""
        if self._config.downsample > 1:
            pictures = functional.avg_pool2d(pictures, self._config.downsample)
        seen = self.trunk(pictures)
        return self.maps(seen), seen

    def read(self, maps: Tensor, seen: Tensor, rays: Tensor) -> _Read:
        """Readout of heat maps and cell features, for cameras with these rays (B, K, 3, 4)."""
        chance = maps.flatten(2).softmax(dim=2).unflatten(2, maps.shape[2:])
        near = _peaks(chance)
        total = near.sum(dim=(2, 3))
        rows, columns = (torch.arange(size, device=maps.device) + 0.5 for size in maps.shape[2:])
        y = (near.sum(dim=3) @ rows) / total / maps.shape[2]
        x = (near.sum(dim=2) @ columns) / total / maps.shape[3]
        weights = (near / total[..., None, None]).flatten(2)[:, :: len(HAND)]
        # In the memory layout of the trunk: in another one its gradients would have to be transposed.
        cells = seen.permute(0, 2, 3, 1).flatten(1, 2)  # (B, h * w, C)
        pooled = self.pool(weights @ cells)  # (B, K * M, POOLED), at the TCPs
        scene = torch.cat([pooled.flatten(1), cells.mean(dim=1)], dim=1)
        places, sure = torch.stack([x, y], dim=2), total[:, :: len(HAND)]
        with torch.no_grad():
            heights = self.centre[:, 2].expand(len(maps), -1)
            usual = self.triangulate(rays, places, sure, heights)[:, :: len(HAND)]
        overview = cells.mean(dim=1, keepdim=True).expand(-1, pooled.shape[1], -1)
        camera = rays.flatten(2).repeat_interleave(self.keypoints, dim=1)
        about = torch.cat([pooled, overview, usual.repeat(1, self._cameras, 1), camera], dim=2)
        return _Read(places, self.rise(about).flatten(1), self.turn(pooled), sure, scene)

    def _doing(self, read: _Read, near: Tensor | None) -> Tensor:
        """Logits (B, N, S) of the subgoal of each other agent.

        From the readout and, with crop refinement, the features of its crops `near` (B, K * M * P, WIDE).
        """
        if self.tell is None:
            return read.scene.new_zeros(len(read.scene), 0, 0)
        seen = [read.scene] if near is None else [read.scene, near[:, :: len(HAND)].flatten(1)]
        return self.tell(torch.cat(seen, dim=1)).unflatten(1, (self._others, -1))

    def fit_points(self, pixels: Tensor, points: Tensor) -> None:
        """Fit mean and spread to points (N, K * M * P, 3) in m, without those outside the picture."""
        inside = inside_picture(pixels)
        for key in range(len(self.centre)):
            every = slice(key, None, len(self.centre))  # for all cameras
            seen = points[:, every][inside[:, every]]
            if len(seen) > 1:
                self.centre[key] = seen.mean(dim=0)
                self.spread[key] = seen[:, 2].std().clamp(min=LEAST_SPREAD_M)

    def triangulate(self, rays: Tensor, places: Tensor, sure: Tensor, heights: Tensor) -> Tensor:
        """Maximum a posteriori points (B, M * P, 3) in m, by least squares with the mean of each as prior.

        From heights (B, M * P) in m, and places (B, K * M * P, 2) in the pictures of K cameras with rays
        (B, K, 3, 4), weighted by confidence (B, K * M).
        """
        places = places.unflatten(1, (self._cameras, -1))  # (B, K, Q, 2)
        along = places @ rays[..., :2].mT + rays[:, :, None, :, 2]
        along = along / along.norm(dim=3, keepdim=True)
        trust = self._trust(sure) / RAY_STD_M
        one = torch.eye(3, device=rays.device)
        across = (one - along[..., None] * along[..., None, :]) * trust.square()[..., None, None]
        origin = rays[..., 3][:, :, None] - self.centre  # (B, K, Q, 3)
        towards = (across @ origin[..., None])[..., 0].sum(dim=1)
        level = self.height_error.clamp(min=LEAST_ERROR_M) ** -2
        up = one[2] * level[:, None]
        normal = across.sum(dim=1) + up[..., None] * one[2] + one * PRIOR_STD_M**-2
        known = towards + up * (heights - self.centre[:, 2])[..., None]
        return self.centre + torch.linalg.solve(normal, known)

    def _trust(self, sure: Tensor) -> Tensor:
        """Confidence of each point (B, K, M * P), from that of its keypoint (B, K * M)."""
        return sure.unflatten(1, (self._cameras, -1)).repeat_interleave(len(HAND), dim=2)

    def see(self, pictures: Tensor, rays: Tensor | None) -> tuple[Tensor, Tensor]:
        """Features (B, F), and the places of all points in the pictures (B, K * M * P, 2), from 0 to 1."""
        rays = self.usual if rays is None else rays
        read = self.read(*self.look(pictures), rays)
        places, near = read.places, None
        if self.crop_refinement is not None:
            places, near = self.crop_refinement(pictures, places)
        trust, by_camera = self._trust(read.sure), (1, (self._cameras, -1))
        rise = (read.rise.unflatten(*by_camera) * trust).sum(dim=1) / trust.sum(dim=1)
        heights = self.centre[:, 2] + self.spread * rise
        points = self.triangulate(rays, places, read.sure, heights).unflatten(1, (-1, len(HAND)))
        tcp = points[:, :, :1]
        hands = torch.cat([tcp, points[:, :, 1:] - tcp], dim=2).flatten(2)
        sure = read.sure.unflatten(*by_camera)[..., None]
        headings = (read.headings.unflatten(*by_camera) * sure).sum(dim=1) / sure.sum(dim=1)
        features = torch.cat([hands, headings, sure.amax(dim=1)], dim=2)
        doing = self._doing(read, near).softmax(dim=2).flatten(1)
        features = torch.cat([features.flatten(1), doing], dim=1)
        return features, places

    def loss(self, pictures: Tensor, rays: Tensor, labels: Labels) -> Tensor:
        """Training loss for labelled pictures (B, 3, H, W) of cameras with these rays (B, K, 3, 4)."""
        maps, seen = self.look(pictures)
        found, inside = self.read(maps, seen, rays), inside_picture(labels.pixels)
        if not inside.any():
            return maps.sum() * 0.0
        cross = _cross_entropy(maps[inside], labels.pixels[inside])
        off = (found.places - labels.pixels)[inside].abs().mean() * maps.shape[3]
        hands = inside[:, :: len(HAND)]
        turn = (found.headings - labels.headings)[hands].abs().sum() / (HEADING * hands.sum().clamp(min=1))
        centre, spread = (each.repeat(self._cameras) for each in (self.centre[:, 2], self.spread))
        above = (found.rise - (labels.points[..., 2] - centre) / spread).abs()
        by_camera, off_m = (1, (self._cameras, -1)), (above.detach() * spread).where(inside, 0)
        count = inside.unflatten(*by_camera).sum(dim=(0, 1))
        error = self.height_error.lerp(off_m.unflatten(*by_camera).sum(dim=(0, 1)) / count, 1 - DECAY)
        self.height_error.copy_(torch.where(count > 0, error, self.height_error))
        rise = above[inside].mean()
        loss = cross + PIXEL_WEIGHT * off + HEADING_WEIGHT * turn + HEIGHT_WEIGHT * rise
        near = None
        if self.crop_refinement is not None:
            closer, near = self.crop_refinement.loss(pictures, found.places, labels.pixels)
            loss = loss + closer
        if self.tell is None:
            return loss
        return loss + functional.cross_entropy(self._doing(found, near).mT, labels.doing)

    def perturbed(self, features: Tensor, generator: torch.Generator) -> Tensor:
        """Features with noise on keypoint positions (m), one draw for all frames of a window."""
        if not self._config.noise:
            return features
        shape = len(features), 1, self.keypoints, PLACED
        shift = torch.randn(shape, generator=generator, device=features.device)
        shift = self._config.noise * functional.pad(shift, (0, OUT - PLACED)).flatten(2)
        return features + functional.pad(shift, (0, features.shape[2] - shift.shape[2]))

    def moved(self, features: Tensor, hands: Tensor) -> Tensor:
        before = self._agents * (self._keyframes + 1) * OUT
        change = functional.pad(hands, (0, 1)).flatten(2)  # confidence unchanged
        return features + functional.pad(change, (before, features.shape[2] - before - change.shape[2]))

    def conditioning(self, features: Tensor, context: Tensor) -> Tensor:
        """Features, then for each own arm its next goal: keypoint, offset from the TCP, clipped offset.

        The clipped offset resolves millimetres, which are lost in a range over the whole table.
        """
        goals = self._goals(features, context)
        offsets = self._from_tcps(goals, context)
        about = torch.cat([goals, offsets, near(offsets)], dim=3)
        return torch.cat([features, about.flatten(2)], dim=2)

    def offsets(self, features: Tensor, context: Tensor) -> Tensor:
        return self._from_tcps(self._goals(features, context), context)

    def _from_tcps(self, goals: Tensor, context: Tensor) -> Tensor:
        """Offsets (B, O, n, 3), in m, from the TCPs of the own agents to goals (B, O, n, OUT)."""
        tcps = [of_agent(context, agent)[0][..., :3] for agent in range(self._agents)]
        return goals[..., :3] - torch.stack(tcps, dim=2)

    def _goals(self, features: Tensor, context: Tensor) -> Tensor:
        """The keypoint (B, O, n, OUT) of the next gripper change of each own agent."""
        count = self._keyframes + 1
        keypoints = features[..., : self._agents * count * OUT].unflatten(2, (self._agents, count, OUT))
        changes = [of_agent(context, agent)[1].argmax(dim=2) for agent in range(self._agents)]
        number = torch.stack(changes, dim=2).clamp(max=self._keyframes)
        return (keypoints * functional.one_hot(number, count)[..., None]).sum(dim=3)


def relit(pictures: Tensor, strength: float, rng: np.random.Generator) -> Tensor:
    """Photometric augmentation (exposure, colour, saturation): (B, H, W, 3) uint8 -> (B, 3, H, W) in [-1, 1].

    By a lookup table for each colour channel, then a matrix: a power of every pixel would take as long as
    the rest of a training step.
    """
    count, value = len(pictures), np.linspace(0.0, 1.0, 256)

    def drawn(span: tuple[float, float], channels: int = 1) -> NDArray[np.float64]:
        return strength * rng.uniform(*span, (count, 1, channels))

    gain, gamma, grey = np.exp(drawn(GAIN) + drawn(TINT, 3)), np.exp(drawn(GAMMA)), drawn(GREY)
    tables = (gain * value[:, None] ** gamma).astype(np.float32)  # (B, 256, 3)
    mix = ((1 - grey) * np.eye(3) + grey / 3).astype(np.float32)  # (B, 3, 3)
    seen = np.empty(pictures.shape, np.float32)
    for picture, table, colours, found in zip(pictures.cpu().numpy(), tables, mix, seen, strict=True):
        cv2.transform(cv2.LUT(picture, table[None]), colours, found)
    np.minimum(seen, 1.0, out=seen)
    return torch.from_numpy(seen).to(pictures.device).mul_(2).sub_(1).permute(0, 3, 1, 2)


def _size(pictures: Tensor) -> Tensor:
    """(W, H) of pictures (B, 3, H, W)."""
    return torch.tensor(pictures.shape[:1:-1], device=pictures.device)


def _peaks(chance: Tensor) -> Tensor:
    """Maps (B, M, h, w), set to zero outside the PEAK x PEAK cells around each maximum."""
    height, width = chance.shape[2:]
    best = chance.flatten(2).argmax(dim=2)
    row, column = best // width, best % width
    rows, columns = (torch.arange(size, device=chance.device) for size in (height, width))
    near_row = (rows - row[..., None]).abs() <= PEAK // 2
    near_column = (columns - column[..., None]).abs() <= PEAK // 2
    return chance * (near_row[..., :, None] & near_column[..., None, :])


def _cross_entropy(maps: Tensor, pixels: Tensor) -> Tensor:
    """Cross entropy of maps (K, h, w) to places (K, 2) from 0 to 1, spread over the four nearest cells."""
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
