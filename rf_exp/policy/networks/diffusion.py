"""Diffusion heads (Chi et al. 2023): they sample the whole chunk, or what to change about one of regression.

Sampling computes what stays the same once: the FiLM table over the diffusion steps and the projection of the
condition.
"""

from collections.abc import Callable

import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from diffusers.utils.torch_utils import randn_tensor
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.config import DiffusionConfig, RefinedConfig
from rf_exp.policy.networks.interfaces import Fit, Head
from rf_exp.policy.networks.layers import hidden
from rf_exp.policy.networks.regression import RegressionHead
from rf_exp.policy.networks.unet import ConditionalUNet1D


def scheduler(config: DiffusionConfig) -> DDPMScheduler | DDIMScheduler:
    """The schedule of noise that a configuration asks for."""
    kind = {"ddpm": DDPMScheduler, "ddim": DDIMScheduler}[config.sampler]
    # "trailing" starts at the noisiest step; diffusers' default would start DDIM somewhere below.
    scheduler = kind(
        config.train_timesteps,
        beta_schedule="squaredcos_cap_v2",
        clip_sample=True,
        prediction_type=config.prediction,
        timestep_spacing="trailing",
    )
    if config.inference_steps:
        scheduler.set_timesteps(config.inference_steps)
    return scheduler


class DiffusionHead(Head):
    """Hidden layers, then a U-Net that takes noise off. Given a chunk, it learns the difference from that."""

    def __init__(
        self, config: DiffusionConfig, condition: int, horizon: int, actions: int, refines: bool = False
    ) -> None:
        super().__init__()
        self._config, self._chunk = config, (horizon, actions)
        self.trunk = nn.Sequential(*hidden([condition, *config.trunk]))
        given = actions if refines else 0
        self.unet = ConditionalUNet1D(actions, [condition, *config.trunk][-1], config.channels, given)
        self.scheduler = scheduler(config)
        self._film_table: Tensor | None = None  # (inference steps, F), once the weights are final
        self._quick: Callable[[Tensor, Tensor], Tensor] | None = None  # the U-Net, then

    def train(self, mode: bool = True) -> "DiffusionHead":
        self._film_table = self._quick = None  # weights may change: what was derived from them is not valid
        return super().train(mode)

    def loss(
        self, condition: Tensor, actions: Tensor, generator: torch.Generator, given: Tensor | None = None
    ) -> Tensor:
        """Error of the prediction over some draws of step and noise for each row."""
        device, draws, count = actions.device, self._config.noise_draws, self._config.train_timesteps
        clean = actions.repeat_interleave(draws, dim=0)
        noise = torch.randn(clean.shape, generator=generator, device=device)
        steps = torch.randint(count, (len(clean),), generator=generator, device=device)
        noisy = self.scheduler.add_noise(clean, noise, steps)  # pyright: ignore[reportArgumentType]
        # The condition is projected once for all its draws, every diffusion step once for the batch.
        table = self.unet.film_of_steps(torch.arange(count, device=device))
        projected = self.unet.film_of_observations(self.trunk(condition))
        film = table[steps] + projected.repeat_interleave(draws, 0)
        prediction = self._predicted(
            noisy, film, None if given is None else given.repeat_interleave(draws, 0)
        )
        error = functional.mse_loss if self._config.loss == "mse" else functional.l1_loss
        return error(prediction.float(), self._target(clean, noise, steps))

    def sample(
        self, condition: Tensor, generators: list[torch.Generator], given: Tensor | None = None
    ) -> Tensor:
        shape = len(condition), *self._chunk
        film = self.unet.film_of_observations(self.trunk(condition))
        sample = randn_tensor(shape, generator=generators, device=condition.device, dtype=condition.dtype)
        steps = self.scheduler.timesteps
        if self._film_table is None:
            self._film_table = self.unet.film_of_steps(steps.to(condition.device))
            if condition.device.type == "cpu":
                known = sample if given is None else torch.cat([sample, given], dim=2)
                self._quick = self.unet.quick(known, film)
        for step, film_of_step in zip(steps, self._film_table, strict=True):
            prediction = self._predicted(sample, film + film_of_step, given)
            # A scheduler returns a tuple only when it is asked to.
            stepped = self.scheduler.step(prediction, step, sample, generator=generators)  # pyright: ignore[reportArgumentType]
            sample = stepped.prev_sample  # pyright: ignore[reportAttributeAccessIssue]
        return sample

    def _predicted(self, noisy: Tensor, film: Tensor, given: Tensor | None) -> Tensor:
        """The prediction of the U-Net: with a chunk of clean actions, its difference from that."""
        network = self._quick or self.unet.modulated
        if given is None:
            return network(noisy, film)
        return given + network(torch.cat([noisy, given], dim=2), film)

    def _target(self, clean: Tensor, noise: Tensor, steps: Tensor) -> Tensor:
        if self._config.prediction == "epsilon":
            return noise
        if self._config.prediction == "sample":
            return clean
        return self.scheduler.get_velocity(clean, noise, steps)  # pyright: ignore[reportArgumentType]


class RefinedHead(Head):
    """Regression, learned first and then left as it is; diffusion learns what to change about its chunk."""

    def __init__(self, config: RefinedConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self._config, sizes = config, (condition, horizon, actions)
        self.diffusion = DiffusionHead(config.diffusion, *sizes, refines=True)
        self.regression = RegressionHead(config.regression, *sizes)

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        """Of the refinement."""
        return self.diffusion.loss(condition, actions, generator, self._given(condition))

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        given = self._given(condition)
        return (
            self.diffusion.sample(condition, generators, given)
            if self._config.diffusion.inference_steps
            else given
        )

    def fits(self) -> list[Fit]:
        first = Fit([self.regression], self.regression.loss, self._config.regression_steps)
        return [first, Fit([self.diffusion], self.loss)]

    @torch.no_grad()
    def _given(self, condition: Tensor) -> Tensor:
        """(B, T, A), which no gradient of the refinement reaches."""
        training = self.regression.training
        given = self.regression.eval().layers(condition)
        self.regression.train(training)
        return given
