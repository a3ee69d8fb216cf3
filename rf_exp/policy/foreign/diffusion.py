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

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.policy.config import DiffusionConfig
from rf_exp.policy.foreign.tensors import Checkpoint, StoredTensor
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.policy.networks.encoders import ResNet18
from rf_exp.policy.networks.heads import GROUPS, SCHEDULERS, DiffusionHead, FilmBlock
from rf_exp.texts import printable

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
LAST_COMMANDS, NEXT_COMMANDS = "agent_pos", "action"  # last and next commands of an arm
LARGEST_PIXELS = (1.0, 255.0)  # largest pixel value that a camera's normaliser may expect
CHANNELS, LARGEST_NUMBER, MOST_LEVELS = 3, 4096, 8  # of a picture; largest number in cfg; of a U-Net
# Arguments of both samplers.
COMMON_ARGUMENTS = (
    "num_train_timesteps",
    "beta_start",
    "beta_end",
    "beta_schedule",
    "clip_sample",
    "prediction_type",
)
UNUSED_TENSORS = re.compile(r"(.*\.)?_dummy_variable|normalizer\.params_dict\.\w+\.input_stats\.\w+")

# Names of tensors in the release, and here.
_ENCODER_NAMES = (
    (r"^conv1\.", "layers.0.0."),
    (r"^bn1\.", "layers.0.1."),
    (r"^layer(\d)\.", r"layers.\1."),
    (r"\.bn(\d)\.", r".norm\1."),
    (r"\.downsample\.", ".skip."),
)
_UNET_NAMES = (
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
    observation_steps: int
    horizon: int
    executed_steps: int  # of a chunk
    imagenet: bool  # whether pictures are also normalised by the statistics of ImageNet
    sampler: str
    inference_steps: int
    schedule: Mapping[str, Any]  # arguments of the sampler

    @staticmethod
    def read(path: Path, node: Mapping[str, Any], sampler: str | None, steps: int | None) -> "Settings":
        """From the configuration in a file. Raises ArgumentError for unsupported settings."""
        config = _ConfigReader(path, node)
        observed = config.get("shape_meta.obs", dict)
        types = {name: config.get(f"shape_meta.obs.{name}.type", str, "low_dim") for name in sorted(observed)}
        encoder = "policy.obs_encoder"
        if config.get(f"{encoder}.resize_shape", object, None) is not None:
            raise config.unsupported(f"{encoder}.resize_shape", "null: pictures are used in their own size")
        if (groups := config.get("policy.n_groups", int, GROUPS)) != GROUPS:
            raise config.unsupported("policy.n_groups", f"{GROUPS}, not {groups}")
        if others := [name for name, kind in types.items() if kind != "rgb" and name != LAST_COMMANDS]:
            raise config.unsupported(f"shape_meta.obs.{others[0]}", f"{LAST_COMMANDS} and cameras (type rgb)")
        schedule = dict(config.get("policy.noise_scheduler", dict))
        file_sampler = str(schedule.pop("_target_", "")).rpartition(".")[2].removesuffix("Scheduler").lower()
        if (sampler := sampler or file_sampler) not in SCHEDULERS:
            raise unknown_choice("sampler", sampler, SCHEDULERS)
        if sampler != file_sampler:  # without arguments of one sampler alone
            schedule = {key: schedule[key] for key in COMMON_ARGUMENTS if key in schedule}
        timesteps = config.get("policy.noise_scheduler.num_train_timesteps", int)
        inference_steps: int | None = steps or config.get("policy.num_inference_steps", int, None)
        cameras = {name: _camera(config, name) for name, kind in types.items() if kind == "rgb"}
        observation_steps, horizon = config.get("n_obs_steps", int), config.get("horizon", int)
        imagenet, executed_steps = (
            config.get(f"{encoder}.imagenet_norm", bool, False),
            config.get("n_action_steps", int),
        )
        return Settings(
            cameras,
            observation_steps,
            horizon,
            executed_steps,
            imagenet,
            sampler,
            inference_steps or timesteps,
            schedule,
        )


class _ConfigReader:
    """Configuration in a file, whose values are checked on access."""

    def __init__(self, path: Path, node: Mapping[str, Any]) -> None:
        self._path, self._node = path, node

    def get(self, key: str, kind: type, *default: Any) -> Any:
        """The value of a dotted key, of type `kind`; `default` is the default of an optional key."""
        value: Any = self._node
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if value is None and default:
            return default[0]
        if not isinstance(value, kind) or (
            isinstance(value, int) and kind is int and not 0 < value <= LARGEST_NUMBER
        ):
            raise ArgumentError(
                f"{self._path}: cfg.{key} is {printable(value, 80)!r}; expected {kind.__name__}"
            )
        return value

    def unsupported(self, key: str, expected: str) -> ArgumentError:
        """The error for a value that would need another network."""
        return ArgumentError(f"{self._path}: cfg.{key} is not supported; expected {expected}")


def _camera(config: _ConfigReader, name: str) -> Camera:
    key = f"shape_meta.obs.{name}.shape"
    shape, crop = config.get(key, list), config.get("policy.obs_encoder.crop_shape", object, None)
    if isinstance(crop, Mapping):
        crop = crop.get(name)
    sizes = [*shape, *(crop or [])]
    fits = all(type(size) is int and 0 < size <= LARGEST_NUMBER for size in sizes)
    if len(shape) != 3 or len(sizes) not in (3, 5) or not fits:
        raise config.unsupported(key, "three numbers of pixels, and two in crop_shape")
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

    def __init__(
        self, settings: Settings, channels: tuple[int, ...], actions: int, brightest: Mapping
    ) -> None:
        """`brightest`: camera -> 1 or 255, the largest pixel value that its normaliser expects."""
        super().__init__()
        self.settings, self.agents, self._brightest = settings, actions // ACTION_SIZE, brightest
        self.encoders = nn.ModuleDict({name: ResNet18() for name in settings.cameras})
        condition = settings.observation_steps * (len(settings.cameras) * ResNet18.features + actions)
        steps = settings.schedule["num_train_timesteps"]
        head_config = DiffusionConfig(
            (), channels, steps, "epsilon", "mse", 1, settings.sampler, settings.inference_steps
        )
        self.head = DiffusionHead(head_config, condition, settings.horizon, actions)
        sizes = {**dict.fromkeys(settings.cameras, 1), LAST_COMMANDS: actions, NEXT_COMMANDS: actions}
        self.normalisers = nn.ModuleDict({name: Affine(size) for name, size in sizes.items()})

    @torch.inference_mode()
    def act(
        self,
        pictures: Mapping[str, NDArray[np.uint8]],
        commands: NDArray[np.float32],
        generator: torch.Generator,
    ) -> NDArray[np.float32]:
        """Actions (T, A) from the pictures (O, H, W, 3) of each camera and the last commands (O, A).

        O observation steps, oldest first; the first action is for the newest of them.
        """
        device = next(self.parameters()).device
        features = [
            self._features(name, torch.from_numpy(pictures[name]).to(device)) for name in self.encoders
        ]
        features.append(self._normaliser(LAST_COMMANDS).normalise(torch.from_numpy(commands).to(device)))
        condition = torch.cat(features, dim=1).flatten()[None]
        chunk = self._normaliser(NEXT_COMMANDS).restore(self.head.sample(condition, [generator])[0])
        return chunk[self.settings.observation_steps - 1 :][: self.settings.executed_steps].cpu().numpy()

    def _features(self, name: str, pictures: Tensor) -> Tensor:
        """Features (O, F) of pictures (O, H, W, 3)."""
        pictures = pictures.movedim(-1, 1).float() * (self._brightest[name] / 255)
        if crop := self.settings.cameras[name].crop:
            top, left = (round((a - b) / 2) for a, b in zip(pictures.shape[2:], crop, strict=True))
            pictures = pictures[..., top : top + crop[0], left : left + crop[1]]
        pictures = self._normaliser(name).normalise(pictures)
        if self.settings.imagenet:  # as in training
            mean, std = (pictures.new_tensor(each)[:, None, None] for each in (IMAGENET_MEAN, IMAGENET_STD))
            pictures = (pictures - mean) / std
        return self.encoders[name](pictures)

    def _normaliser(self, name: str) -> Affine:
        normaliser = self.normalisers[name]
        assert isinstance(normaliser, Affine)
        return normaliser


def read_policy(path: Path, sampler: str | None = None, inference_steps: int | None = None) -> ReleasedPolicy:
    """The policy of a `.ckpt` of the release; sampler and steps are by default those of the file.

    Raises ArgumentError for a file of another kind, that names code, or that holds another network;
    StageError for a damaged one.
    """
    file = Checkpoint(path)
    saved = file.contents if isinstance(file.contents, dict) else {}
    networks, config = saved.get("state_dicts"), saved.get("cfg")
    if not isinstance(networks, dict) or not isinstance(config, dict):
        keys = ", ".join(sorted(printable(key, 40) for key in saved)[:8]) or "none"
        raise ArgumentError(
            f"{path} is no checkpoint of Diffusion Policy: keys {keys}; expected cfg, state_dicts"
        )
    stored = networks.get("ema_model") or networks.get("model")
    if not isinstance(stored, dict) or not all(isinstance(each, StoredTensor) for each in stored.values()):
        raise ArgumentError(f"{path} holds no network; expected tensors in state_dicts.ema_model or .model")
    tensors = {str(name): file.tensor(each) for name, each in stored.items()}
    settings = Settings.read(path, config, sampler, inference_steps)
    first_weights = [f"model.down_modules.{level}.0.blocks.0.block.0.weight" for level in range(MOST_LEVELS)]
    channels = tuple(len(tensors[name]) for name in first_weights if name in tensors)
    actions = tensors.get("model.final_conv.1.bias", torch.empty(0)).numel()
    if not actions or actions % ACTION_SIZE:
        raise ArgumentError(f"{path} predicts {actions} numbers; expected {ACTION_SIZE} for each arm")
    brightest = {}
    for name in settings.cameras:
        largest = tensors.get(f"normalizer.params_dict.{name}.input_stats.max", torch.empty(0))
        brightest[name] = float(largest.max()) if largest.numel() else LARGEST_PIXELS[0]
        if brightest[name] not in LARGEST_PIXELS:
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
    renamed: dict[str, Tensor] = {}
    film: dict[str, Tensor] = {}  # FiLM projections of the blocks
    for name, tensor in tensors.items():
        if UNUSED_TENSORS.fullmatch(name):
            continue
        if match := re.fullmatch(r"obs_encoder\.key_model_map\.(\w+)\.(.+)", name):
            name = f"encoders.{match[1]}.{_replaced(match[2], _ENCODER_NAMES)}"
        elif match := re.fullmatch(r"normalizer\.params_dict\.(\w+)\.(scale|offset)", name):
            name = f"normalisers.{match[1]}.{match[2]}"
        elif match := re.fullmatch(r"model\.(.+)", name):
            name = f"head.unet.{_replaced(match[1], _UNET_NAMES)}"
        (film if ".cond_encoder.1." in name else renamed)[name] = tensor.float()
    blocks = {each.film_offset: name for name, each in policy.named_modules() if isinstance(each, FilmBlock)}
    for kind in ("weight", "bias"):
        names = [f"{blocks[first]}.cond_encoder.1.{kind}" for first in sorted(blocks)]
        rows = [film.pop(name) for name in names if name in film]
        if len({each.shape[1:] for each in rows}) == 1:
            renamed[f"head.unet.film.{kind}"] = torch.cat(rows)
    return renamed | film


def _replaced(name: str, rules: tuple[tuple[str, str], ...]) -> str:
    for there, here in rules:
        name = re.sub(there, here, name)
    return name


def _check(path: Path, expected: Mapping[str, torch.Size], tensors: Mapping[str, Tensor]) -> None:
    """Raises ArgumentError naming the first tensor that differs from the network, or is not finite."""
    for name in sorted(expected.keys() | tensors.keys()):
        here, there = expected.get(name), tensors[name].shape if name in tensors else None
        if here != there:
            descriptions = [
                f"has {tuple(each)}" if each is not None else "lacks it" for each in (there, here)
            ]
            raise ArgumentError(
                f"{path} holds another network than Diffusion Policy with ResNet-18 and GroupNorm: "
                f"{printable(name, 120)}: the file {descriptions[0]}, the network {descriptions[1]}"
            )
        if not tensors[name].isfinite().all():
            raise ArgumentError(f"{path}: {printable(name, 120)} is not finite; its weights are unusable")
