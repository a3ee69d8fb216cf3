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

from rf_exp.artifacts import drop_defaults
from rf_exp.policy.config import CELL_PX, LATER_DEFAULTS, KeypointsConfig
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS, HEADING_SIZE
from rf_exp.policy.examples.windows import Labels, Windows
from rf_exp.policy.inputs.observation_spec import ObservationSpec, clipped_offsets, own_tcp_and_changes
from rf_exp.policy.inputs.pictures import inside_picture, scaled
from rf_exp.policy.inputs.view import View
from rf_exp.policy.networks.interfaces import Draw, Encoder, Fit

CHANNELS = 32
POOLED_CHANNELS = 32  # features pooled at a keypoint
PEAK_CELLS = 5  # cells, side of the square around the maximum of a map over which the mean is taken
POINTS_SIZE = 3 * len(GRIPPER_POINTS)  # per keypoint: TCP, other points relative to it (m)
KEYPOINT_SIZE = POINTS_SIZE + HEADING_SIZE + 1  # with heading and confidence
GOAL_SIZE = KEYPOINT_SIZE + 3 + 3  # features of the next goal of an own arm: keypoint, offset, clipped offset
# Weights of the loss terms beside the cross entropies.
PIXEL_WEIGHT, HEADING_WEIGHT, HEIGHT_WEIGHT = 0.05, 1.0, 0.2
LEAST_SPREAD_M = 0.005  # least standard deviation that heights are scaled by: less is noise
# Standard deviations of a point: from the ray of a certain detection, and, as a prior, from its mean.
RAY_STD_M, PRIOR_STD_M = 0.005, 0.5
LEAST_ERROR_M = 0.001  # least error of a predicted height
HEIGHT_ERROR_DECAY = 0.99  # decay per batch of the running mean error of heights
# Crop refinement: channels; pixels of the picture per cell of a crop; and the largest offset of a crop from
# its keypoint in training, as a fraction of its side.
CROP_CHANNELS, CROP_CELL_PX, LARGEST_CROP_OFFSET = 16, 2, 0.25
PIXEL_CENTRE = 0.5  # offset of the centre of a pixel, on which kernels are centred
# Photometric augmentation: ranges of logarithms, but for the share of grey. A pilot with these held from 0.35
# to 1.5 times the usual light.
GAIN, TINT, GAMMA, GREY = (-0.7, 0.5), (-0.3, 0.3), (-0.4, 0.4), (0.0, 0.5)


class _Dilated(nn.Module):
    """Residual 3x3 convolution with a dilation of `dilation` cells."""

    def __init__(self, dilation: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(CHANNELS, CHANNELS, 3, padding=dilation, dilation=dilation, bias=False)
        self.norm = nn.GroupNorm(4, CHANNELS)

    def forward(self, x: Tensor) -> Tensor:
        return x + functional.relu(self.norm(self.conv(x)))


class _NetworkPerKeypoint(nn.Module):
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
    """Crop refinement: locates K points in square crops of `side` pixels around K coarse places.

    Its feature maps have C = CROP_CHANNELS channels.
    """

    def __init__(self, points: int, side: int) -> None:
        super().__init__()
        self._side = side

        def layer(inputs: int, size: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
            return nn.Sequential(
                nn.Conv2d(inputs, CROP_CHANNELS, size, stride, dilation * (size // 2), dilation, bias=False),
                nn.GroupNorm(4, CROP_CHANNELS),
                nn.ReLU(),
            )

        self.trunk = nn.Sequential(
            layer(3, 5, CROP_CELL_PX), layer(CROP_CHANNELS, 3), layer(CROP_CHANNELS, 3, dilation=2)
        )
        # One vector per point; its map is the product of the vector with the features of its own crop.
        self.points = nn.Parameter(torch.randn(points, CROP_CHANNELS) / CROP_CHANNELS**0.5)

    def forward(self, pictures: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Pictures (B, 3, H, W), places (B, K, 2) from 0 to 1 -> refined places, features (B, K, C)."""
        return self._read_out(*self._heat_maps(pictures, places), _size(pictures))

    def loss(self, pictures: Tensor, places: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """Training loss for the true places (B, K, 2) of the points, and the features there (B, K, C).

        NaN and places outside the picture are ignored. The loss is the error in pixels plus the cross entropy
        of the maps: with the first alone errors are a third larger.
        """
        inside, size = inside_picture(true), _size(pictures)
        largest_offset = LARGEST_CROP_OFFSET * self._side / size
        true = torch.where(inside[..., None], true, places.detach())
        crop_centres = true + (places.detach() - true).clamp(-largest_offset, largest_offset)
        maps, features, corners = self._heat_maps(pictures, crop_centres)
        refined, point_features = self._read_out(maps, features, corners, size)
        if not inside.any():
            return places.sum() * 0.0, point_features
        error_px = ((refined - true)[inside] * size).abs().mean()
        cells = (true * size - corners - PIXEL_CENTRE) / CROP_CELL_PX + 0.5
        cross_entropy = _cross_entropy(maps[inside], cells[inside] / cells.new_tensor(maps.shape[:1:-1]))
        return PIXEL_WEIGHT * error_px + cross_entropy, point_features

    def _heat_maps(self, pictures: Tensor, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Maps (B, K, h, w) of crops as logits, features (B, K, C, h, w), upper left corners (B, K, 2)."""
        size = _size(pictures)
        corners = (places.detach() * size - self._side / 2).round().long()
        corners = corners.clamp_min(0).minimum(size - self._side)  # wholly inside the picture
        offsets = torch.arange(self._side, device=places.device)
        columns, rows = (corners[..., axis, None] + offsets for axis in (0, 1))  # (B, K, side)
        picture_index = torch.arange(len(places), device=places.device)[:, None, None, None]
        crops = pictures.permute(0, 2, 3, 1)[picture_index, rows[..., :, None], columns[..., None, :]]
        features = self.trunk(crops.flatten(0, 1).permute(0, 3, 1, 2)).unflatten(0, places.shape[:2])
        return torch.einsum("bkchw,kc->bkhw", features, self.points), features, corners

    def _read_out(
        self, maps: Tensor, features: Tensor, corners: Tensor, size: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Mean places (B, K, 2) of the maps, from 0 to 1 in the picture, and features there (B, K, C)."""
        maps = functional.softmax(maps.flatten(2), dim=2).view_as(maps)
        point_features = torch.einsum("bkhw,bkchw->bkc", maps, features)
        rows, columns = (
            CROP_CELL_PX * torch.arange(count, device=maps.device) + PIXEL_CENTRE for count in maps.shape[2:]
        )
        in_crop = torch.stack([maps.sum(dim=2) @ columns, maps.sum(dim=3) @ rows], dim=2)
        return (corners + in_crop) / size, point_features


@dataclass(frozen=True)
class _Readout:
    """Readout of the heat maps of B pictures, for each of K cameras."""

    places: Tensor  # (B, K * M * P, 2) in the picture, from 0 to 1
    scaled_heights: Tensor  # (B, K * M * P) heights above their mean, in units of `spread`
    headings: Tensor  # (B, K * M, HEADING_SIZE)
    confidence: Tensor  # (B, K * M) probability mass of the peak
    scene: Tensor  # (B, K * M * POOLED_CHANNELS + CHANNELS) features at the keypoints, mean over the picture


class KeypointEncoder(Encoder):
    """Pictures (B, 3, H, W) in [-1, 1] of K cameras side by side -> features (B, M * KEYPOINT_SIZE + N * S).

    M keypoints of P = len(GRIPPER_POINTS) points each: every own agent at its keyframes and at the end, and
    all agents now; then the probabilities of S subgoals for each of N other agents.
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
        self.keypoints, points = spec.keypoints(view), spec.keypoints(view) * len(GRIPPER_POINTS)
        self.features = self.keypoints * KEYPOINT_SIZE + self._others * subgoals
        camera_keypoints = self._cameras * self.keypoints  # one for each camera
        self.trunk = nn.Sequential(
            nn.Conv2d(3, CHANNELS, 2 * CELL_PX, CELL_PX, padding=CELL_PX // 2, bias=False),
            nn.GroupNorm(4, CHANNELS),
            nn.ReLU(),
            *(_Dilated(dilation) for dilation in config.dilations),
        )
        self.maps = nn.Conv2d(CHANNELS, camera_keypoints * len(GRIPPER_POINTS), 1)
        self.pool = nn.Linear(CHANNELS, POOLED_CHANNELS)
        self.register_buffer("usual", torch.eye(3, 4).repeat(len(view.streams), self._cameras, 1, 1))
        self.register_buffer("centre", torch.zeros(points, 3))
        self.register_buffer("spread", torch.full((points,), LEAST_SPREAD_M))
        self.register_buffer("height_error", torch.full((points,), LEAST_SPREAD_M))
        self.turn = _NetworkPerKeypoint(camera_keypoints, POOLED_CHANNELS, 32, HEADING_SIZE)
        self.rise = _NetworkPerKeypoint(
            camera_keypoints, POOLED_CHANNELS + CHANNELS + 3 + 12, 32, len(GRIPPER_POINTS)
        )
        # Subgoals of others, from the scene: a finished arm looks as before it began, its work does not.
        self.tell: nn.Module | None = None
        side = config.crop_refinement
        if subgoal_scores := self._others * subgoals:
            # The features of crops are for closed fingers, which are a pixel wide.
            keypoint_features = POOLED_CHANNELS + (CROP_CHANNELS if side else 0)
            self.tell = nn.Sequential(
                nn.Linear(camera_keypoints * keypoint_features + CHANNELS, 64),
                nn.Mish(),
                nn.Linear(64, subgoal_scores),
            )
        self.crop_refinement = CropRefinement(camera_keypoints * len(GRIPPER_POINTS), side) if side else None

    @property
    def size(self) -> int:
        return self.features + self._agents * GOAL_SIZE

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
            strength = config.photometric
            inputs = photometric_augmentation(pictures, strength, draw.rng) if strength else scaled(pictures)
            return self.loss(inputs, rays, labels)

        cache_key = drop_defaults(asdict(config), **LATER_DEFAULTS["encoder"]["keypoints"])
        cache_key.pop("noise")
        return Fit([self], loss, config.steps, config.rate, cache_key=cache_key)

    def heat_maps(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Heat maps (B, K * M * P, h, w), as logits, and the features of each cell (B, C, h, w)."""
        if self._config.downsample > 1:
            pictures = functional.avg_pool2d(pictures, self._config.downsample)
        features = self.trunk(pictures)
        return self.maps(features), features

    def read_out(self, maps: Tensor, features: Tensor, rays: Tensor) -> _Readout:
        """Readout of heat maps and cell features, for cameras with these rays (B, K, 3, 4)."""
        probabilities = maps.flatten(2).softmax(dim=2).unflatten(2, maps.shape[2:])
        peaks = _peaks(probabilities)
        mass = peaks.sum(dim=(2, 3))
        rows, columns = (torch.arange(size, device=maps.device) + 0.5 for size in maps.shape[2:])
        y = (peaks.sum(dim=3) @ rows) / mass / maps.shape[2]
        x = (peaks.sum(dim=2) @ columns) / mass / maps.shape[3]
        weights = (peaks / mass[..., None, None]).flatten(2)[:, :: len(GRIPPER_POINTS)]
        # In the memory layout of the trunk: in another one its gradients would have to be transposed.
        cells = features.permute(0, 2, 3, 1).flatten(1, 2)  # (B, h * w, C)
        pooled = self.pool(weights @ cells)  # (B, K * M, POOLED_CHANNELS), at the TCPs
        scene = torch.cat([pooled.flatten(1), cells.mean(dim=1)], dim=1)
        places, confidence = torch.stack([x, y], dim=2), mass[:, :: len(GRIPPER_POINTS)]
        with torch.no_grad():
            heights = self.centre[:, 2].expand(len(maps), -1)
            rough_points = self.triangulate(rays, places, confidence, heights)[:, :: len(GRIPPER_POINTS)]
        mean_features = cells.mean(dim=1, keepdim=True).expand(-1, pooled.shape[1], -1)
        camera_rays = rays.flatten(2).repeat_interleave(self.keypoints, dim=1)
        inputs = torch.cat(
            [pooled, mean_features, rough_points.repeat(1, self._cameras, 1), camera_rays], dim=2
        )
        return _Readout(places, self.rise(inputs).flatten(1), self.turn(pooled), confidence, scene)

    def _subgoal_logits(self, readout: _Readout, crop_features: Tensor | None) -> Tensor:
        """Logits (B, N, S) of the subgoal of each other agent.

        From the readout and, with crop refinement, the features of its crops (B, K * M * P, C).
        """
        if self.tell is None:
            return readout.scene.new_zeros(len(readout.scene), 0, 0)
        inputs = (
            [readout.scene]
            if crop_features is None
            else [readout.scene, crop_features[:, :: len(GRIPPER_POINTS)].flatten(1)]
        )
        return self.tell(torch.cat(inputs, dim=1)).unflatten(1, (self._others, -1))

    def fit_points(self, pixels: Tensor, points: Tensor) -> None:
        """Fit mean and spread to points (N, K * M * P, 3) in m, without those outside the picture."""
        inside = inside_picture(pixels)
        for key in range(len(self.centre)):
            all_cameras = slice(key, None, len(self.centre))  # for all cameras
            visible = points[:, all_cameras][inside[:, all_cameras]]
            if len(visible) > 1:
                self.centre[key] = visible.mean(dim=0)
                self.spread[key] = visible[:, 2].std().clamp(min=LEAST_SPREAD_M)

    def triangulate(self, rays: Tensor, places: Tensor, confidence: Tensor, heights: Tensor) -> Tensor:
        """Maximum a posteriori points (B, M * P, 3) in m, by least squares with the mean of each as prior.

        From heights (B, M * P) in m, and places (B, K * M * P, 2) in the pictures of K cameras with rays
        (B, K, 3, 4), weighted by confidence (B, K * M).
        """
        places = places.unflatten(1, (self._cameras, -1))  # (B, K, Q, 2)
        directions = places @ rays[..., :2].mT + rays[:, :, None, :, 2]
        directions = directions / directions.norm(dim=3, keepdim=True)
        weights = self._point_confidence(confidence) / RAY_STD_M
        identity = torch.eye(3, device=rays.device)
        projections = (identity - directions[..., None] * directions[..., None, :]) * weights.square()[
            ..., None, None
        ]
        origin = rays[..., 3][:, :, None] - self.centre  # (B, K, Q, 3)
        ray_terms = (projections @ origin[..., None])[..., 0].sum(dim=1)
        height_weights = self.height_error.clamp(min=LEAST_ERROR_M) ** -2
        height_terms = identity[2] * height_weights[:, None]
        normal = projections.sum(dim=1) + height_terms[..., None] * identity[2] + identity * PRIOR_STD_M**-2
        right_side = ray_terms + height_terms * (heights - self.centre[:, 2])[..., None]
        return self.centre + torch.linalg.solve(normal, right_side)

    def _point_confidence(self, confidence: Tensor) -> Tensor:
        """Confidence of each point (B, K, M * P), from that of its keypoint (B, K * M)."""
        return confidence.unflatten(1, (self._cameras, -1)).repeat_interleave(len(GRIPPER_POINTS), dim=2)

    def encode(self, pictures: Tensor, rays: Tensor | None) -> tuple[Tensor, Tensor]:
        """Features (B, F), and the places of all points in the pictures (B, K * M * P, 2), from 0 to 1."""
        rays = self.usual if rays is None else rays
        readout = self.read_out(*self.heat_maps(pictures), rays)
        places, crop_features = readout.places, None
        if self.crop_refinement is not None:
            places, crop_features = self.crop_refinement(pictures, places)
        weights, by_camera = self._point_confidence(readout.confidence), (1, (self._cameras, -1))
        scaled_heights = (readout.scaled_heights.unflatten(*by_camera) * weights).sum(dim=1) / weights.sum(
            dim=1
        )
        heights = self.centre[:, 2] + self.spread * scaled_heights
        points = self.triangulate(rays, places, readout.confidence, heights).unflatten(
            1, (-1, len(GRIPPER_POINTS))
        )
        tcp = points[:, :, :1]
        gripper_points = torch.cat([tcp, points[:, :, 1:] - tcp], dim=2).flatten(2)
        confidence = readout.confidence.unflatten(*by_camera)[..., None]
        headings = (readout.headings.unflatten(*by_camera) * confidence).sum(dim=1) / confidence.sum(dim=1)
        features = torch.cat([gripper_points, headings, confidence.amax(dim=1)], dim=2)
        subgoals = self._subgoal_logits(readout, crop_features).softmax(dim=2).flatten(1)
        features = torch.cat([features.flatten(1), subgoals], dim=1)
        return features, places

    def loss(self, pictures: Tensor, rays: Tensor, labels: Labels) -> Tensor:
        """Training loss for labelled pictures (B, 3, H, W) of cameras with these rays (B, K, 3, 4)."""
        maps, features = self.heat_maps(pictures)
        readout, inside = self.read_out(maps, features, rays), inside_picture(labels.pixels)
        if not inside.any():
            return maps.sum() * 0.0
        cross_entropy = _cross_entropy(maps[inside], labels.pixels[inside])
        place_error = (readout.places - labels.pixels)[inside].abs().mean() * maps.shape[3]
        keypoints_inside = inside[:, :: len(GRIPPER_POINTS)]
        heading_error = (readout.headings - labels.headings)[keypoints_inside].abs().sum() / (
            HEADING_SIZE * keypoints_inside.sum().clamp(min=1)
        )
        centre, spread = (each.repeat(self._cameras) for each in (self.centre[:, 2], self.spread))
        height_errors = (readout.scaled_heights - (labels.points[..., 2] - centre) / spread).abs()
        by_camera, errors_m = (
            (1, (self._cameras, -1)),
            (height_errors.detach() * spread).where(inside, 0),
        )
        count = inside.unflatten(*by_camera).sum(dim=(0, 1))
        mean_error = self.height_error.lerp(
            errors_m.unflatten(*by_camera).sum(dim=(0, 1)) / count, 1 - HEIGHT_ERROR_DECAY
        )
        self.height_error.copy_(torch.where(count > 0, mean_error, self.height_error))
        height_loss = height_errors[inside].mean()
        loss = (
            cross_entropy
            + PIXEL_WEIGHT * place_error
            + HEADING_WEIGHT * heading_error
            + HEIGHT_WEIGHT * height_loss
        )
        crop_features = None
        if self.crop_refinement is not None:
            crop_loss, crop_features = self.crop_refinement.loss(pictures, readout.places, labels.pixels)
            loss = loss + crop_loss
        if self.tell is None:
            return loss
        return loss + functional.cross_entropy(
            self._subgoal_logits(readout, crop_features).mT, labels.other_subgoals
        )

    def perturbed(self, features: Tensor, generator: torch.Generator) -> Tensor:
        """Features with noise on keypoint positions (m), one draw for all frames of a window."""
        if not self._config.noise:
            return features
        shape = len(features), 1, self.keypoints, POINTS_SIZE
        shift = torch.randn(shape, generator=generator, device=features.device)
        shift = self._config.noise * functional.pad(shift, (0, KEYPOINT_SIZE - POINTS_SIZE)).flatten(2)
        return features + functional.pad(shift, (0, features.shape[2] - shift.shape[2]))

    def displaced(self, features: Tensor, gripper_offsets: Tensor) -> Tensor:
        before = self._agents * (self._keyframes + 1) * KEYPOINT_SIZE
        change = functional.pad(gripper_offsets, (0, 1)).flatten(2)  # confidence unchanged
        return features + functional.pad(change, (before, features.shape[2] - before - change.shape[2]))

    def conditioning(self, features: Tensor, context: Tensor) -> Tensor:
        """Features, then for each own arm its next goal: keypoint, offset from the TCP, clipped offset.

        The clipped offset resolves millimetres, which are lost in a range over the whole table.
        """
        goals = self._goals(features, context)
        offsets = self._from_tcps(goals, context)
        inputs = torch.cat([goals, offsets, clipped_offsets(offsets)], dim=3)
        return torch.cat([features, inputs.flatten(2)], dim=2)

    def offsets(self, features: Tensor, context: Tensor) -> Tensor:
        return self._from_tcps(self._goals(features, context), context)

    def _from_tcps(self, goals: Tensor, context: Tensor) -> Tensor:
        """Offsets (B, O, n, 3), in m, from the TCPs of the own agents to goals (B, O, n, KEYPOINT_SIZE)."""
        tcps = [own_tcp_and_changes(context, agent)[0][..., :3] for agent in range(self._agents)]
        return goals[..., :3] - torch.stack(tcps, dim=2)

    def _goals(self, features: Tensor, context: Tensor) -> Tensor:
        """The keypoint (B, O, n, KEYPOINT_SIZE) of the next gripper change of each own agent."""
        count = self._keyframes + 1
        keypoints = features[..., : self._agents * count * KEYPOINT_SIZE].unflatten(
            2, (self._agents, count, KEYPOINT_SIZE)
        )
        changes = [own_tcp_and_changes(context, agent)[1].argmax(dim=2) for agent in range(self._agents)]
        number = torch.stack(changes, dim=2).clamp(max=self._keyframes)
        return (keypoints * functional.one_hot(number, count)[..., None]).sum(dim=3)


def photometric_augmentation(pictures: Tensor, strength: float, rng: np.random.Generator) -> Tensor:
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
    result = np.empty(pictures.shape, np.float32)
    for picture, table, colours, out in zip(pictures.cpu().numpy(), tables, mix, result, strict=True):
        cv2.transform(cv2.LUT(picture, table[None]), colours, out)
    np.minimum(result, 1.0, out=result)
    return torch.from_numpy(result).to(pictures.device).mul_(2).sub_(1).permute(0, 3, 1, 2)


def _size(pictures: Tensor) -> Tensor:
    """(W, H) of pictures (B, 3, H, W)."""
    return torch.tensor(pictures.shape[:1:-1], device=pictures.device)


def _peaks(probabilities: Tensor) -> Tensor:
    """Maps (B, M, h, w), set to zero outside the PEAK_CELLS x PEAK_CELLS cells around each maximum."""
    height, width = probabilities.shape[2:]
    best = probabilities.flatten(2).argmax(dim=2)
    row, column = best // width, best % width
    rows, columns = (torch.arange(size, device=probabilities.device) for size in (height, width))
    near_row = (rows - row[..., None]).abs() <= PEAK_CELLS // 2
    near_column = (columns - column[..., None]).abs() <= PEAK_CELLS // 2
    return probabilities * (near_row[..., :, None] & near_column[..., None, :])


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
