"""Parts of the diffusion policy: hidden layers, scaled pictures, the schedule of noise."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from torch import Tensor, nn

from rf_exp.policy.config import PolicyConfig


def scheduler(config: PolicyConfig) -> DDPMScheduler | DDIMScheduler:
    """The schedule of noise that a configuration asks for."""
    kind = {"ddpm": DDPMScheduler, "ddim": DDIMScheduler}[config.sampler]
    # "trailing" starts at the noisiest step; diffusers' default would start DDIM somewhere below.
    scheduler = kind(
        config.train_diffusion_steps,
        beta_schedule="squaredcos_cap_v2",
        clip_sample=True,
        prediction_type=config.prediction,
        timestep_spacing="trailing",
    )
    if config.inference_diffusion_steps:
        scheduler.set_timesteps(config.inference_diffusion_steps)
    return scheduler


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
