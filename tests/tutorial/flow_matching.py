"""Custom policy head: flow matching (Lipman et al. 2023) along straight lines from noise to actions.

The suite's U-Net predicts the end of a line, which gives the velocity along it; Euler's method integrates it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy import ConditionalUNet1D, Head, HeadConfig, add_head, bounded, hidden

TIMES = 100.0  # scales time to the range of diffusion steps, which the U-Net expects


@dataclass(frozen=True)
class FlowMatchingConfig(HeadConfig):
    """Layers as in `head.diffusion`; `euler_steps` does not affect the weights."""

    trunk: tuple[int, ...] = bounded(above=0)
    channels: tuple[int, ...] = bounded()
    euler_steps: int = bounded(1000, above=0, acting=True)


class FlowMatching(Head):
    """Flow matching from noise at time 0 to actions at time 1."""

    def __init__(self, config: FlowMatchingConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self._steps, self._chunk, sizes = config.euler_steps, (horizon, actions), [condition, *config.trunk]
        self.trunk = nn.Sequential(*hidden(sizes))
        self.unet = ConditionalUNet1D(actions, sizes[-1], config.channels)

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        noise = torch.randn(actions.shape, generator=generator, device=actions.device)
        time = torch.rand(len(actions), generator=generator, device=actions.device)
        interpolated = torch.lerp(noise, actions, time[:, None, None])
        return functional.l1_loss(self.unet(interpolated, TIMES * time, self.trunk(condition)), actions)

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        projected = self.trunk(condition)
        rows = [torch.randn(self._chunk, generator=generator) for generator in generators]
        sample = torch.stack(rows).to(projected.device)
        for step in range(self._steps):
            time = torch.full((len(sample),), step / self._steps, device=projected.device)
            end = self.unet(sample, TIMES * time, projected)
            sample = sample + (end - sample) / (self._steps - step)
        return sample


add_head("flow_matching", FlowMatchingConfig, FlowMatching)
