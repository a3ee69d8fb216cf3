"""Diffusion policies of the authors' release, rebuilt from the tensors of their checkpoints.

    state_dicts.ema_model, or .model where no average was kept:
        obs_encoder.key_model_map.<camera>.*    ResNet-18 with GroupNorm, one for each camera
        model.*                                 the conditional U-Net (Chi et al. 2023)
        normalizer.params_dict.<key>.*          x * scale + offset, of cameras, `agent_pos` and `action`
    cfg                                         beyond shapes: observation and chunk steps, scheduler, crop

Encoder and U-Net are those of the recipe `paper`, with other names of tensors; the FiLM projections are one
matrix here and one for each block there.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rf_exp.errors import ArgumentError, choices
from rf_exp.policy.config import DiffusionConfig
from rf_exp.policy.foreign.tensors import Checkpoint, Stored
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.policy.networks.encoders import ResNet18
from rf_exp.policy.networks.heads import GROUPS, SCHEDULERS, DiffusionHead, FilmBlock
from rf_exp.texts import printable

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
TOLD, ACTION = "agent_pos", "action"  # last and next commands of an arm
BRIGHTEST = (1.0, 255.0)  # largest pixel value that a camera's normaliser may expect
CHANNELS, MOST, MOST_LEVELS = 3, 4096, 8  # of a picture; largest number in cfg; of a U-Net
# Arguments of both samplers.
COMMON = ("num_train_timesteps", "beta_start", "beta_end", "beta_schedule", "clip_sample", "prediction_type")
UNUSED = re.compile(r"(.*\.)?_dummy_variable|normalizer\.params_dict\.\w+\.input_stats\.\w+")

# Names of tensors in the release, and here.
_ENCODER = (
    (r"^conv1\.", "layers.0.0."),
    (r"^bn1\.", "layers.0.1."),
    (r"^layer(\d)\.", r"layers.\1."),
    (r"\.bn(\d)\.", r".norm\1."),
    (r"\.downsample\.", ".skip."),
)
_UNET = (
    (r"^diffusion_step_encoder\.1\.", "step_embedding.linear_1."),
    (r"^diffusion_step_encoder\.3\.", "step_embedding.linear_2."),
    (r"^(down|up)_modules\.(\d+)\.([01])\.", r"\1.\2.resnets.\3."),
    (r"^down_modules\.(\d+)\.2\.", r"down.\1.downsample."),
    (r"^up_modules\.(\d+)\.2\.", r"up.\1.upsample."),
    (r"^mid_modules\.([01])\.", r"middle.resnets.\1."),
    (r"\.blocks\.0\.block\.0\.", ".conv_in.conv1d."),
    (r"\.blocks\.0\.block\.1\.", ".conv_in.group_norm."),
    (r"\.blocks\.1\.block\.0\.", ".conv_out.conv1d."),
    (r"\.blocks\.1\.block\.1\.", ".conv_out.group_norm."),
    (r"^final_conv\.0\.block\.0\.", "out.final_conv1d_1."),
    (r"^final_conv\.0\.block\.1\.", "out.final_conv1d_gn."),
    (r"^final_conv\.1\.", "out.final_conv1d_2."),
)


@dataclass(frozen=True)
class Camera:
    """A camera that a policy observes."""

    height: int
    width: int
    crop: tuple[int, int] | None  # height and width of the centre crop


@dataclass(frozen=True)
class Settings:
    """Settings in the file of a policy, beside its tensors."""

    cameras: Mapping[str, Camera]  # in the order of their features
    moments: int  # observation steps
    horizon: int
    steps: int  # executed steps of a chunk
    imagenet: bool  # whether pictures are also normalised by the statistics of ImageNet
    sampler: str
    inference_steps: int
    schedule: Mapping[str, Any]  # arguments of the sampler

    @staticmethod
    def read(path: Path, node: Mapping[str, Any], sampler: str | None, steps: int | None) -> "Settings":
        """From the configuration in a file. Raises ArgumentError for unsupported settings."""
        said = _Node(path, node)
        kinds = said.of("shape_meta.obs", dict)
        types = {name: said.of(f"shape_meta.obs.{name}.type", str, "low_dim") for name in sorted(kinds)}
        encoder = "policy.obs_encoder"
        if said.of(f"{encoder}.resize_shape", object, None) is not None:
            raise said.refused(
                f"{encoder}.resize_shape", "null: its pictures are looked at in their own size"
            )
        if (groups := said.of("policy.n_groups", int, GROUPS)) != GROUPS:
            raise said.refused("policy.n_groups", f"{GROUPS}, not {groups}")
        if others := [name for name, kind in types.items() if kind != "rgb" and name != TOLD]:
            raise said.refused(f"shape_meta.obs.{others[0]}", f"{TOLD} and cameras (type rgb)")
        schedule = dict(said.of("policy.noise_scheduler", dict))
        found = str(schedule.pop("_target_", "")).rpartition(".")[2].removesuffix("Scheduler").lower()
        if (sampler := sampler or found) not in SCHEDULERS:
            raise choices("sampler", sampler, SCHEDULERS)
        if sampler != found:  # without arguments of one sampler alone
            schedule = {key: schedule[key] for key in COMMON if key in schedule}
        timesteps = said.of("policy.noise_scheduler.num_train_timesteps", int)
        told: int | None = steps or said.of("policy.num_inference_steps", int, None)
        cameras = {name: _camera(said, name) for name, kind in types.items() if kind == "rgb"}
        moments, horizon = said.of("n_obs_steps", int), said.of("horizon", int)
        imagenet, executed = said.of(f"{encoder}.imagenet_norm", bool, False), said.of("n_action_steps", int)
        return Settings(cameras, moments, horizon, executed, imagenet, sampler, told or timesteps, schedule)


class _Node:
    """Configuration in a file, whose values are checked on access."""

    def __init__(self, path: Path, node: Mapping[str, Any]) -> None:
        self._path, self._node = path, node

    def of(self, key: str, kind: type, *otherwise: Any) -> Any:
        """The value of a dotted key, of type `kind`; `otherwise` is the default of an optional key."""
        found: Any = self._node
        for part in key.split("."):
            found = found.get(part) if isinstance(found, Mapping) else None
        if found is None and otherwise:
            return otherwise[0]
        if not isinstance(found, kind) or (isinstance(found, int) and kind is int and not 0 < found <= MOST):
            raise ArgumentError(
                f"{self._path}: cfg.{key} is {printable(found, 80)!r}; expected {kind.__name__}"
            )
        return found

    def refused(self, key: str, expected: str) -> ArgumentError:
        """The error for a value that would need another network."""
        return ArgumentError(f"{self._path}: cfg.{key} is not what this suite can make; expected {expected}")


def _camera(said: _Node, name: str) -> Camera:
    key = f"shape_meta.obs.{name}.shape"
    shape, crop = said.of(key, list), said.of("policy.obs_encoder.crop_shape", object, None)
    if isinstance(crop, Mapping):
        crop = crop.get(name)
    sizes = [*shape, *(crop or [])]
    fits = all(type(size) is int and 0 < size <= MOST for size in sizes)
    if len(shape) != 3 or len(sizes) not in (3, 5) or not fits:
        raise said.refused(key, "three numbers of pixels, and two in crop_shape")
    height, width = shape[1:] if shape[0] == CHANNELS else shape[:2]
    return Camera(height, width, None if crop is None else (crop[0], crop[1]))


class Affine(nn.Module):
    """Linear normaliser: x * scale + offset."""

    scale: Tensor
    offset: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        for name in ("scale", "offset"):
            self.register_buffer(name, torch.empty(size))

    def normalise(self, values: Tensor) -> Tensor:
        return values * self.scale + self.offset

    def restore(self, values: Tensor) -> Tensor:
        return (values - self.offset) / self.scale


class ReleasedPolicy(nn.Module):
    """Diffusion policy of the release, for one arm or several: last observations -> actions."""

    def __init__(self, said: Settings, channels: tuple[int, ...], actions: int, brightest: Mapping) -> None:
        """`brightest`: camera -> 1 or 255, the largest pixel value that its normaliser expects."""
        super().__init__()
        self.said, self.agents, self._brightest = said, actions // ACTION_SIZE, brightest
        self.encoders = nn.ModuleDict({name: ResNet18() for name in said.cameras})
        condition = said.moments * (len(said.cameras) * ResNet18.features + actions)
        steps = said.schedule["num_train_timesteps"]
        how = DiffusionConfig((), channels, steps, "epsilon", "mse", 1, said.sampler, said.inference_steps)
        self.head = DiffusionHead(how, condition, said.horizon, actions)
        sizes = {**dict.fromkeys(said.cameras, 1), TOLD: actions, ACTION: actions}
        self.normalisers = nn.ModuleDict({name: Affine(size) for name, size in sizes.items()})

    @torch.inference_mode()
    def act(
        self, pictures: Mapping[str, NDArray[np.uint8]], told: NDArray[np.float32], generator: torch.Generator
    ) -> NDArray[np.float32]:
        """Actions (T, A) from the pictures (O, H, W, 3) of each camera and the last commands `told` (O, A).

        O observation steps, oldest first; the first action is for the newest of them.
        """
        device = next(self.parameters()).device
        seen = [self._features(name, torch.from_numpy(pictures[name]).to(device)) for name in self.encoders]
        seen.append(self._normaliser(TOLD).normalise(torch.from_numpy(told).to(device)))
        condition = torch.cat(seen, dim=1).flatten()[None]
        chunk = self._normaliser(ACTION).restore(self.head.sample(condition, [generator])[0])
        return chunk[self.said.moments - 1 :][: self.said.steps].cpu().numpy()

    def _features(self, name: str, pictures: Tensor) -> Tensor:
        """Features (O, F) of pictures (O, H, W, 3)."""
        pictures = pictures.movedim(-1, 1).float() * (self._brightest[name] / 255)
        if crop := self.said.cameras[name].crop:
            top, left = (round((a - b) / 2) for a, b in zip(pictures.shape[2:], crop, strict=True))
            pictures = pictures[..., top : top + crop[0], left : left + crop[1]]
        pictures = self._normaliser(name).normalise(pictures)
        if self.said.imagenet:  # as in training
            mean, std = (pictures.new_tensor(each)[:, None, None] for each in (IMAGENET_MEAN, IMAGENET_STD))
            pictures = (pictures - mean) / std
        return self.encoders[name](pictures)

    def _normaliser(self, name: str) -> Affine:
        found = self.normalisers[name]
        assert isinstance(found, Affine)
        return found


def read_policy(path: Path, sampler: str | None = None, inference_steps: int | None = None) -> ReleasedPolicy:
    """The policy of a `.ckpt` of the release; sampler and steps are by default those of the file.

    Raises ArgumentError for a file of another kind, that names code, or that holds another network;
    StageError for a damaged one.
    """
    file = Checkpoint(path)
    saved = file.saved if isinstance(file.saved, dict) else {}
    networks, said = saved.get("state_dicts"), saved.get("cfg")
    if not isinstance(networks, dict) or not isinstance(said, dict):
        keys = ", ".join(sorted(printable(key, 40) for key in saved)[:8]) or "none"
        raise ArgumentError(
            f"{path} is no checkpoint of Diffusion Policy: keys {keys}; expected cfg, state_dicts"
        )
    stored = networks.get("ema_model") or networks.get("model")
    if not isinstance(stored, dict) or not all(isinstance(each, Stored) for each in stored.values()):
        raise ArgumentError(f"{path} holds no network; expected tensors in state_dicts.ema_model or .model")
    tensors = {str(name): file.tensor(each) for name, each in stored.items()}
    settings = Settings.read(path, said, sampler, inference_steps)
    first = [f"model.down_modules.{level}.0.blocks.0.block.0.weight" for level in range(MOST_LEVELS)]
    channels = tuple(len(tensors[name]) for name in first if name in tensors)
    actions = tensors.get("model.final_conv.1.bias", torch.empty(0)).numel()
    if not actions or actions % ACTION_SIZE:
        raise ArgumentError(f"{path} predicts {actions} numbers; expected {ACTION_SIZE} for each arm")
    brightest = {}
    for name in settings.cameras:
        top = tensors.get(f"normalizer.params_dict.{name}.input_stats.max", torch.empty(0))
        brightest[name] = float(top.max()) if top.numel() else BRIGHTEST[0]
        if brightest[name] not in BRIGHTEST:
            raise ArgumentError(f"{path}: pictures of {name} go up to {brightest[name]:g}; expected 1 or 255")
    with torch.device("meta"):
        policy = ReleasedPolicy(settings, channels, actions, brightest)
    renamed = _renamed(policy, tensors)
    _check(path, {name: each.shape for name, each in policy.state_dict().items()}, renamed)
    policy.load_state_dict(renamed, assign=True)
    try:
        policy.head.scheduler = SCHEDULERS[settings.sampler](**settings.schedule)
        policy.head.scheduler.set_timesteps(settings.inference_steps)
    except (NotImplementedError, TypeError, ValueError) as error:
        raise ArgumentError(f"{path}: cfg.policy.noise_scheduler cannot be made: {error}") from error
    return policy.eval()


def _renamed(policy: ReleasedPolicy, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors of a file under their names here; unknown ones keep their own."""
    found: dict[str, Tensor] = {}
    film: dict[str, Tensor] = {}  # FiLM projections of the blocks
    for name, tensor in tensors.items():
        if UNUSED.fullmatch(name):
            continue
        if known := re.fullmatch(r"obs_encoder\.key_model_map\.(\w+)\.(.+)", name):
            name = f"encoders.{known[1]}.{_replaced(known[2], _ENCODER)}"
        elif known := re.fullmatch(r"normalizer\.params_dict\.(\w+)\.(scale|offset)", name):
            name = f"normalisers.{known[1]}.{known[2]}"
        elif known := re.fullmatch(r"model\.(.+)", name):
            name = f"head.unet.{_replaced(known[1], _UNET)}"
        (film if ".cond_encoder.1." in name else found)[name] = tensor.float()
    blocks = {each.first: name for name, each in policy.named_modules() if isinstance(each, FilmBlock)}
    for kind in ("weight", "bias"):
        names = [f"{blocks[first]}.cond_encoder.1.{kind}" for first in sorted(blocks)]
        rows = [film.pop(name) for name in names if name in film]
        if len({each.shape[1:] for each in rows}) == 1:
            found[f"head.unet.film.{kind}"] = torch.cat(rows)
    return found | film


def _replaced(name: str, rules: tuple[tuple[str, str], ...]) -> str:
    for there, here in rules:
        name = re.sub(there, here, name)
    return name


def _check(path: Path, expected: Mapping[str, torch.Size], found: Mapping[str, Tensor]) -> None:
    """Raises ArgumentError naming the first tensor that differs from the network, or is not finite."""
    for name in sorted(expected.keys() | found.keys()):
        here, there = expected.get(name), found[name].shape if name in found else None
        if here != there:
            told = [f"has {tuple(each)}" if each is not None else "lacks it" for each in (there, here)]
            raise ArgumentError(
                f"{path} holds another network than Diffusion Policy with ResNet-18 and GroupNorm: "
                f"{printable(name, 120)}: the file {told[0]}, the network {told[1]}"
            )
        if not found[name].isfinite().all():
            raise ArgumentError(f"{path}: {printable(name, 120)} is not finite; its weights are of no use")
