"""A head of one's own: flow matching (Lipman et al. 2023), straight lines from noise to actions.

The U-Net of the suite predicts where a line ends; the velocity along it follows, and Euler's method takes it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy import ConditionalUNet1D, Head, HeadConfig, add_head, bounded, hidden

TIMES = 100.0  # the U-Net was made for the numbers of diffusion steps


@dataclass(frozen=True)
class FlowMatchingConfig(HeadConfig):
    """Layers as in `head.diffusion`; how many steps of Euler's method is not learned."""

    trunk: tuple[int, ...] = bounded(above=0)
    channels: tuple[int, ...] = bounded()
    euler_steps: int = bounded(1000, above=0, acting=True)


class FlowMatching(Head):
    """Noise at time 0, actions at time 1."""

    def __init__(self, config: FlowMatchingConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self._steps, self._chunk, sizes = config.euler_steps, (horizon, actions), [condition, *config.trunk]
        self.trunk = nn.Sequential(*hidden(sizes))
        self.unet = ConditionalUNet1D(actions, sizes[-1], config.channels)

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        noise = torch.randn(actions.shape, generator=generator, device=actions.device)
        time = torch.rand(len(actions), generator=generator, device=actions.device)
        on_the_line = torch.lerp(noise, actions, time[:, None, None])
        return functional.l1_loss(self.unet(on_the_line, TIMES * time, self.trunk(condition)), actions)

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
