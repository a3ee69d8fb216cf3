"""Checkpoints in the layout of the authors' release, and a reference implementation of their network.

The reference is written out tensor by tensor, independently of the suite's network.
"""

from collections import OrderedDict
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from omegaconf import OmegaConf
from torch import Tensor
from torch.nn.functional import conv1d, conv2d, conv_transpose1d, group_norm, linear, max_pool2d, mish, relu

SIZE = 32, 48  # height and width of the pictures
HORIZON, OBSERVATION_STEPS, STEPS, TIMESTEPS = 8, 3, 6, 4
CHANNELS = 8, 16
STEP_FEATURES = 128  # size of the embedding of a diffusion step
SCALE, OFFSET = 2.0, -1.0  # normalisation of pictures


def encoder_shapes() -> dict[str, tuple[int, ...]]:
    """Tensor -> shape of a ResNet-18 with GroupNorm and without its classifier."""
    found: dict[str, tuple[int, ...]] = {
        "conv1.weight": (64, 3, 7, 7),
        "bn1.weight": (64,),
        "bn1.bias": (64,),
    }
    for stage, (before, width) in enumerate(((64, 64), (64, 128), (128, 256), (256, 512)), start=1):
        for block, inputs in enumerate((before, width)):
            own = f"layer{stage}.{block}"
            found |= {
                f"{own}.conv1.weight": (width, inputs, 3, 3),
                f"{own}.conv2.weight": (width, width, 3, 3),
            }
            found |= {
                f"{own}.bn{number}.{kind}": (width,) for number in (1, 2) for kind in ("weight", "bias")
            }
            if stage > 1 and block == 0:
                found |= {f"{own}.downsample.0.weight": (width, inputs, 1, 1)}
                found |= {f"{own}.downsample.1.{kind}": (width,) for kind in ("weight", "bias")}
    return found


def unet_shapes(actions: int, condition: int) -> dict[str, tuple[int, ...]]:
    """Tensor -> shape of the conditional U-Net."""

    def conv(name: str, inputs: int, outputs: int, kernel: int) -> dict[str, tuple[int, ...]]:
        return {f"{name}.weight": (outputs, inputs, kernel), f"{name}.bias": (outputs,)}

    def norm(name: str, width: int) -> dict[str, tuple[int, ...]]:
        return {f"{name}.weight": (width,), f"{name}.bias": (width,)}

    def block(name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        made = {f"{name}.cond_encoder.1.weight": (2 * outputs, STEP_FEATURES + condition)}
        made |= {f"{name}.cond_encoder.1.bias": (2 * outputs,)}
        for number, before in enumerate((inputs, outputs)):
            made |= conv(f"{name}.blocks.{number}.block.0", before, outputs, 5)
            made |= norm(f"{name}.blocks.{number}.block.1", outputs)
        return made | (conv(f"{name}.residual_conv", inputs, outputs, 1) if inputs != outputs else {})

    first, last = CHANNELS[0], CHANNELS[-1]
    found: dict[str, tuple[int, ...]] = {}
    for number, (inputs, outputs) in (
        (1, (STEP_FEATURES, 4 * STEP_FEATURES)),
        (3, (4 * STEP_FEATURES, STEP_FEATURES)),
    ):
        name = f"diffusion_step_encoder.{number}"
        found |= {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
    for level, (inputs, outputs) in enumerate(pairwise((actions, *CHANNELS))):
        found |= block(f"down_modules.{level}.0", inputs, outputs)
        found |= block(f"down_modules.{level}.1", outputs, outputs)
        if outputs != last:
            found |= conv(f"down_modules.{level}.2.conv", outputs, outputs, 3)
    found |= block("mid_modules.0", last, last) | block("mid_modules.1", last, last)
    for level, (outputs, inputs) in enumerate(reversed([*pairwise(CHANNELS)])):
        found |= block(f"up_modules.{level}.0", 2 * inputs, outputs)
        found |= block(f"up_modules.{level}.1", outputs, outputs)
        found |= conv(f"up_modules.{level}.2.conv", outputs, outputs, 4)
    found |= conv("final_conv.0.block.0", first, first, 5) | norm("final_conv.0.block.1", first)
    return found | conv("final_conv.1", first, actions, 1)


def network(cameras: tuple[str, ...], arms: int, brightest: float = 1.0) -> "OrderedDict[str, Tensor]":
    """State dict with the tensors of the release, with random values."""
    rng = torch.Generator().manual_seed(0)
    actions = 8 * arms
    condition = OBSERVATION_STEPS * (512 * len(cameras) + actions)
    shapes = {f"model.{name}": shape for name, shape in unet_shapes(actions, condition).items()}
    for camera in cameras:
        own = f"obs_encoder.key_model_map.{camera}."
        shapes |= {own + name: shape for name, shape in encoder_shapes().items()}
    found: OrderedDict[str, Tensor] = OrderedDict()
    for name, shape in shapes.items():
        drawn = torch.randn(shape, generator=rng)
        fan = max(1, int(np.prod(shape[1:])))
        is_norm = len(shape) == 1 and name.endswith("weight")
        found[name] = 1 + 0.1 * drawn if is_norm else drawn / fan**0.5 if len(shape) > 1 else 0.1 * drawn
    for name, size in {**dict.fromkeys(cameras, 1), "agent_pos": actions, "action": actions}.items():
        own = f"normalizer.params_dict.{name}"
        picture = name in cameras
        found[f"{own}.scale"] = torch.full((size,), SCALE / brightest if picture else 1.5)
        found[f"{own}.offset"] = torch.full((size,), OFFSET if picture else 0.25)
        for kind, value in (("min", 0.0), ("max", brightest), ("mean", 0.5), ("std", 0.3)):
            found[f"{own}.input_stats.{kind}"] = torch.full((size,), value)
    return OrderedDict(found, **{"obs_encoder._dummy_variable": torch.empty(0)})


def configuration(cameras: tuple[str, ...], arms: int, **changes: Any) -> dict[str, Any]:
    """The configuration in checkpoints of the release, as far as it is read; `changes` by dotted keys."""
    pictures = {name: {"shape": [3, *SIZE], "type": "rgb"} for name in cameras}
    low_dim = {"agent_pos": {"shape": [8 * arms], "type": "low_dim"}}
    scheduler = {
        "_target_": "diffusers.schedulers.scheduling_ddpm.DDPMScheduler",
        "num_train_timesteps": TIMESTEPS,
        "beta_start": 0.0001,
        "beta_end": 0.02,
        "beta_schedule": "squaredcos_cap_v2",
        "variance_type": "fixed_small",
        "clip_sample": True,
        "prediction_type": "epsilon",
    }
    encoder = {"resize_shape": None, "crop_shape": None, "imagenet_norm": True, "use_group_norm": True}
    policy = {
        "noise_scheduler": scheduler,
        "obs_encoder": encoder,
        "num_inference_steps": TIMESTEPS,
        "n_groups": 8,
    }
    node = {
        "_target_": "diffusion_policy.workspace.robotworkspace.RobotWorkspace",
        "shape_meta": {"obs": {**pictures, **low_dim}, "action": {"shape": [8 * arms]}},
        "horizon": HORIZON,
        "n_obs_steps": OBSERVATION_STEPS,
        "n_action_steps": STEPS,
        "policy": policy,
    }
    made = OmegaConf.create(node)
    for key, value in changes.items():
        OmegaConf.update(made, key, value)
    return made  # pyright: ignore[reportReturnType]


def write(path: Path, cameras: tuple[str, ...] = ("head_cam",), arms: int = 1, **changes: Any) -> Path:
    """Writes a checkpoint in the layout of the release; `state` in `changes` replaces its state dict."""
    state = changes.pop("state", None)
    tensors = network(cameras, arms) if state is None else state
    step = {"step": torch.tensor(3.0), "exp_avg": torch.zeros(2)}
    optimizer = {"state": {0: step}, "param_groups": [{"lr": 1e-4, "betas": (0.95, 0.999), "params": [0]}]}
    states = {"model": OrderedDict(), "ema_model": tensors, "optimizer": optimizer}
    pickles = {"epoch": b"\x80\x04K\x03.", "_output_dir": b"\x80\x04N."}
    saved = {"cfg": configuration(cameras, arms, **changes), "state_dicts": states, "pickles": pickles}
    torch.save(saved, path)
    return path


# -- reference implementation of the network -----------------------------------------------------------


def features(tensors: Mapping[str, Tensor], camera: str, pictures: Tensor, imagenet: bool) -> Tensor:
    """Features (O, 512) of pictures (O, 3, H, W), which the normaliser scales first."""
    own = f"obs_encoder.key_model_map.{camera}."
    t = {name.removeprefix(own): each for name, each in tensors.items() if name.startswith(own)}
    normaliser = f"normalizer.params_dict.{camera}."
    x = pictures * tensors[normaliser + "scale"] + tensors[normaliser + "offset"]
    if imagenet:
        mean, std = (
            torch.tensor(each)[:, None, None] for each in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
        )
        x = (x - mean) / std

    def norm(x: Tensor, name: str) -> Tensor:
        return group_norm(x, x.shape[1] // 16, t[f"{name}.weight"], t[f"{name}.bias"])

    x = max_pool2d(relu(norm(conv2d(x, t["conv1.weight"], stride=2, padding=3), "bn1")), 3, 2, padding=1)
    for stage in (1, 2, 3, 4):
        for block in (0, 1):
            name, stride = f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1
            hidden = relu(norm(conv2d(x, t[f"{name}.conv1.weight"], stride=stride, padding=1), f"{name}.bn1"))
            hidden = norm(conv2d(hidden, t[f"{name}.conv2.weight"], padding=1), f"{name}.bn2")
            if f"{name}.downsample.0.weight" in t:
                x = norm(conv2d(x, t[f"{name}.downsample.0.weight"], stride=stride), f"{name}.downsample.1")
            x = relu(hidden + x)
    return x.mean(dim=(2, 3))


def predicted(tensors: Mapping[str, Tensor], sample: Tensor, step: int, observation: Tensor) -> Tensor:
    """Noise predicted in a chunk (1, T, A) at a diffusion step, conditioned on an observation (1, C)."""
    t = {name.removeprefix("model."): each for name, each in tensors.items() if name.startswith("model.")}
    half = STEP_FEATURES // 2
    angles = step * torch.exp(torch.arange(half) * -np.log(10000) / (half - 1))
    embedded = torch.cat([angles.sin(), angles.cos()])[None]
    for number in (1, 3):
        name = f"diffusion_step_encoder.{number}"
        embedded = linear(embedded, t[f"{name}.weight"], t[f"{name}.bias"])
        embedded = mish(embedded) if number == 1 else embedded
    condition = torch.cat([embedded, observation], dim=1)

    def conv(x: Tensor, name: str, **how: int) -> Tensor:
        return conv1d(x, t[f"{name}.weight"], t[f"{name}.bias"], **how)

    def part(x: Tensor, name: str) -> Tensor:
        made = conv(x, f"{name}.block.0", padding=2)
        return mish(group_norm(made, 8, t[f"{name}.block.1.weight"], t[f"{name}.block.1.bias"]))

    def block(x: Tensor, name: str) -> Tensor:
        film = linear(mish(condition), t[f"{name}.cond_encoder.1.weight"], t[f"{name}.cond_encoder.1.bias"])
        scale, bias = film.reshape(1, 2, -1, 1).unbind(dim=1)
        hidden = part(scale * part(x, f"{name}.blocks.0") + bias, f"{name}.blocks.1")
        return hidden + (conv(x, f"{name}.residual_conv") if f"{name}.residual_conv.weight" in t else x)

    x, skips = sample.transpose(1, 2), []
    for level in range(len(CHANNELS)):
        x = block(block(x, f"down_modules.{level}.0"), f"down_modules.{level}.1")
        skips.append(x)
        if f"down_modules.{level}.2.conv.weight" in t:
            x = conv(x, f"down_modules.{level}.2.conv", stride=2, padding=1)
    x = block(block(x, "mid_modules.0"), "mid_modules.1")
    for level in range(len(CHANNELS) - 1):
        x = torch.cat([x, skips.pop()], dim=1)
        x = block(block(x, f"up_modules.{level}.0"), f"up_modules.{level}.1")
        name = f"up_modules.{level}.2.conv"
        x = conv_transpose1d(x, t[f"{name}.weight"], t[f"{name}.bias"], stride=2, padding=1)
    return conv(part(x, "final_conv.0"), "final_conv.1").transpose(1, 2)


def actions(
    tensors: Mapping[str, Tensor],
    scheduler: DDPMScheduler | DDIMScheduler,
    pictures: Mapping[str, Tensor],
    agent_pos: Tensor,
    generator: torch.Generator,
    imagenet: bool = True,
) -> Tensor:
    """Actions (STEPS, A) from pictures (O, 3, H, W) per camera, in their order, and `agent_pos` (O, A)."""

    def normaliser(name: str) -> tuple[Tensor, Tensor]:
        own = f"normalizer.params_dict.{name}"
        return tensors[f"{own}.scale"], tensors[f"{own}.offset"]

    seen = [features(tensors, name, each, imagenet) for name, each in pictures.items()]
    scale, offset = normaliser("agent_pos")
    observation = torch.cat([*seen, agent_pos * scale + offset], dim=1).reshape(1, -1)
    sample = torch.randn((1, HORIZON, agent_pos.shape[1]), generator=generator)
    for step in scheduler.timesteps:
        noise = predicted(tensors, sample, int(step), observation)
        sample = scheduler.step(noise, step, sample, generator=generator).prev_sample  # pyright: ignore
    scale, offset = normaliser("action")
    return ((sample - offset) / scale)[0, OBSERVATION_STEPS - 1 : OBSERVATION_STEPS - 1 + STEPS]
