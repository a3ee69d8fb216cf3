"""Heads: regression, diffusion by a U-Net, and regression refined by diffusion.

The U-Net is that of Diffusion Policy (Chi et al. 2023, CNN variant; the paper's section 4 uses it at a
horizon of 8), built from diffusers' blocks. Every residual block is modulated by scale and bias (FiLM) from
the diffusion step and the observation. All FiLM projections are one linear layer: one matrix product instead
of one for each block. Because W [step; observation] = W_step step + W_obs observation, the step part is a
table over the diffusion steps, and the observation part is computed once for each observation.
"""

import warnings
from collections.abc import Callable
from itertools import pairwise

import torch
from diffusers.configuration_utils import ConfigMixin, register_to_config
from diffusers.models.embeddings import TimestepEmbedding, Timesteps
from diffusers.models.modeling_utils import ModelMixin
from diffusers.models.resnet import ResidualTemporalBlock1D
from diffusers.models.unets.unet_1d_blocks import (
    DownResnetBlock1D,
    MidResTemporalBlock1D,
    OutConv1DBlock,
    UpResnetBlock1D,
)
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from diffusers.utils.torch_utils import randn_tensor
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import mish

from rf_exp.errors import ArgumentError
from rf_exp.policy.config import DiffusionConfig, RefinedConfig, RegressionConfig
from rf_exp.policy.networks.interfaces import Fit, Head, hidden

STEP_SIZE = 128  # width of the embedding of a diffusion step
GROUPS = 8  # of every GroupNorm, fixed in diffusers' blocks
SCHEDULERS = {"ddpm": DDPMScheduler, "ddim": DDIMScheduler}


class RegressionHead(Head):
    """Regression head: a perceptron with dropout."""

    def __init__(self, config: RegressionConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *hidden([condition, *config.hidden], config.dropout),
            nn.Linear(config.hidden[-1], horizon * actions),
            nn.Unflatten(1, (horizon, actions)),
        )

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        return functional.l1_loss(self.layers(condition).float(), actions)

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        return self.layers(condition)


class FilmBlock(ResidualTemporalBlock1D):
    """A residual block that reads its scale and bias from its part of the U-Net's FiLM vector."""

    def __init__(self, in_channels: int, out_channels: int, film_offset: int) -> None:
        super().__init__(in_channels, out_channels, embed_dim=1)
        del self.time_emb, self.time_emb_act  # the U-Net projects for all blocks together
        self.film_offset, self.channels = film_offset, out_channels

    def forward(self, inputs: Tensor, t: Tensor) -> Tensor:
        """Inputs (B, in, T) and the FiLM vector of the whole U-Net `t` (B, F) -> (B, out, T)."""
        scale, bias = t[:, self.film_offset : self.film_offset + 2 * self.channels, None].chunk(2, dim=1)
        hidden = self.conv_out(scale * self.conv_in(inputs) + bias)
        return hidden + self.residual_conv(inputs)


class ConditionalUNet1D(ModelMixin, ConfigMixin):
    """Predicts noise or actions from noisy actions, diffusion step and observation.

    With action_size 8, observation_size 3 * (512 + 9) and channels (256, 512, 1024) it has the size of
    the paper's policy. Raises ArgumentError for channels that its blocks cannot hold.
    """

    @register_to_config
    def __init__(
        self,
        action_size: int,
        observation_size: int,
        channels: tuple[int, ...] = (256, 512, 1024),
        extra_channels: int = 0,  # known channels over time, beside the noisy actions
    ) -> None:
        super().__init__()
        if len(channels) < 2 or any(width <= 0 or width % GROUPS for width in channels):
            raise ArgumentError(
                f"unet channels {tuple(channels)}; expected at least two levels, each a multiple of {GROUPS}"
            )
        self._film_size = 0
        self.step_features = Timesteps(STEP_SIZE, flip_sin_to_cos=False, downscale_freq_shift=1)
        self.step_embedding = TimestepEmbedding(STEP_SIZE, 4 * STEP_SIZE, "mish", out_dim=STEP_SIZE)
        down = [DownResnetBlock1D(a, b) for a, b in pairwise((action_size + extra_channels, *channels))]
        down[-1].downsample = None  # the deepest level keeps its length
        up = [UpResnetBlock1D(b, a, add_upsample=True) for a, b in reversed(list(pairwise(channels)))]
        self.down = nn.ModuleList(self._with_film_blocks(block) for block in down)
        self.middle = self._with_film_blocks(MidResTemporalBlock1D(channels[-1], channels[-1], embed_dim=1))
        self.up = nn.ModuleList(self._with_film_blocks(block) for block in up)
        self.out = OutConv1DBlock(GROUPS, action_size, channels[0], "mish")
        if extra_channels:  # the output is added to the given chunk: it starts at zero
            nn.init.zeros_(self.out.final_conv1d_2.weight)
            nn.init.zeros_(self.out.final_conv1d_2.bias)  # pyright: ignore[reportArgumentType]
        self.film = nn.Linear(STEP_SIZE + observation_size, self._film_size)

    def _with_film_blocks(self, block: nn.Module) -> nn.Module:
        """A block of diffusers with its residual blocks replaced by `FilmBlock`s."""
        blocks = nn.ModuleList()
        for resnet in block.resnets:  # pyright: ignore[reportGeneralTypeIssues]
            conv = resnet.conv_in.conv1d
            blocks.append(FilmBlock(conv.in_channels, conv.out_channels, self._film_size))
            self._film_size += 2 * conv.out_channels
        block.resnets = blocks
        return block

    def film_of_steps(self, steps: Tensor) -> Tensor:
        """The step's share of the FiLM vector: diffusion steps (S,) -> (S, F)."""
        weight = self.film.weight[:, :STEP_SIZE]
        return mish(self.step_embedding(self.step_features(steps).to(weight.dtype))) @ weight.T

    def film_of_observations(self, observation: Tensor) -> Tensor:
        """The observation's share of the FiLM vector, bias included: (B, C) -> (B, F)."""
        return functional.linear(mish(observation), self.film.weight[:, STEP_SIZE:], self.film.bias)

    def modulated(self, sample: Tensor, film: Tensor) -> Tensor:
        """The U-Net: noisy actions and given channels (B, T, A + G), FiLM vector (B, F) -> (B, T, A)."""
        hidden, skips = sample.transpose(1, 2), []
        for block in self.down:
            hidden, states = block(hidden, film)
            skips.append(states)
        hidden = self.middle(hidden, film)
        for block in self.up:
            hidden = block(hidden, skips.pop(), film)
        return self.out(hidden).transpose(1, 2)

    def traced(self, sample: Tensor, film: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        """`modulated`, traced for inputs like these with any number of rows: no Python between operations.

        Results are the same to the last bit; a single row on a CPU takes a third of the time
        (benchmarks/policy_call.py). It uses the module's own weights, in its current mode. On a GPU it is a
        CUDA graph for exactly as many rows, and the next call overwrites what the last one returned.
        """
        if sample.is_cuda:
            return self._captured(sample, film)
        with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
            warnings.simplefilter("ignore")  # about sizes that depend on data: these depend on the network
            shapes = (torch.zeros(2, *sample.shape[1:]), torch.zeros(2, *film.shape[1:]))
            module = torch.jit.trace_module(self, {"modulated": shapes}, check_trace=False)
        return module.modulated  # pyright: ignore[reportReturnType]

    @torch.no_grad()
    def _captured(self, sample: Tensor, film: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        inputs, side_stream = (sample.clone(), film.clone()), torch.cuda.Stream(sample.device)
        side_stream.wait_stream(torch.cuda.current_stream(sample.device))
        with torch.cuda.stream(side_stream):  # warm-up: a first call chooses kernels, and may synchronise
            self.modulated(*inputs)
        torch.cuda.current_stream(sample.device).wait_stream(side_stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            result = self.modulated(*inputs)

        @torch.no_grad()
        def replayed(sample: Tensor, film: Tensor) -> Tensor:
            for buffer, value in zip(inputs, (sample, film), strict=True):
                buffer.copy_(value)
            graph.replay()
            return result

        return replayed

    def forward(self, sample: Tensor, steps: Tensor, observation: Tensor) -> Tensor:
        """Noisy actions (B, T, A), diffusion steps (B,), observation (B, C) -> prediction (B, T, A).

        T must be a multiple of 2 ** (levels - 1). Reference computation: sampling and training use the
        parts above, which a test compares with it.
        """
        embedding = self.step_embedding(self.step_features(steps).to(sample.dtype))
        return self.modulated(sample, self.film(mish(torch.cat([embedding, observation], dim=1))))


class DiffusionHead(Head):
    """Diffusion head: hidden layers, then a denoising U-Net. Given a chunk, it learns the difference from it.

    Constant parts are computed once: the FiLM table over the diffusion steps, the projected condition.
    """

    def __init__(
        self, config: DiffusionConfig, condition: int, horizon: int, actions: int, refines: bool = False
    ) -> None:
        super().__init__()
        self._config, self._chunk_shape = config, (horizon, actions)
        sizes = [condition, *config.trunk]
        self.trunk = nn.Sequential(*hidden(sizes))
        self.unet = ConditionalUNet1D(actions, sizes[-1], config.channels, actions if refines else 0)
        # "trailing" starts at the noisiest step; diffusers' default would start DDIM below it.
        self.scheduler = SCHEDULERS[config.sampler](
            config.train_timesteps,
            beta_schedule="squaredcos_cap_v2",
            clip_sample=True,
            prediction_type=config.prediction,
            timestep_spacing="trailing",
        )
        if config.inference_steps:
            self.scheduler.set_timesteps(config.inference_steps)
        self._film_table: Tensor | None = None  # (inference steps, F), once the weights are final
        self._traced_unet: Callable[[Tensor, Tensor], Tensor] | None = None  # traced U-Net, likewise
        self._rows = 0  # number of rows that `_traced_unet` was made for

    def train(self, mode: bool = True) -> "DiffusionHead":
        # Weights may change, which invalidates what was derived from them.
        self._film_table, self._traced_unet, self._rows = None, None, 0
        return super().train(mode)

    def loss(
        self, condition: Tensor, actions: Tensor, generator: torch.Generator, base_chunk: Tensor | None = None
    ) -> Tensor:
        """Prediction error over `noise_draws` draws of step and noise for each row."""
        device, draws, count = actions.device, self._config.noise_draws, self._config.train_timesteps
        clean = actions.repeat_interleave(draws, dim=0)
        noise = torch.randn(clean.shape, generator=generator, device=device)
        steps = torch.randint(count, (len(clean),), generator=generator, device=device)
        noisy = self.scheduler.add_noise(clean, noise, steps)  # pyright: ignore[reportArgumentType]
        if base_chunk is not None:
            base_chunk = base_chunk.repeat_interleave(draws, dim=0)
        # The condition is projected once for all its draws, every diffusion step once for the batch.
        table = self.unet.film_of_steps(torch.arange(count, device=device))
        projected = self.unet.film_of_observations(self.trunk(condition))
        film = table[steps] + projected.repeat_interleave(draws, dim=0)
        target = {"epsilon": noise, "sample": clean}.get(self._config.prediction)
        if target is None:
            target = self.scheduler.get_velocity(clean, noise, steps)  # pyright: ignore[reportArgumentType]
        error = functional.mse_loss if self._config.loss == "mse" else functional.l1_loss
        return error(self._predicted(noisy, film, base_chunk).float(), target)

    def sample(
        self, condition: Tensor, generators: list[torch.Generator], base_chunk: Tensor | None = None
    ) -> Tensor:
        shape = len(condition), *self._chunk_shape
        film = self.unet.film_of_observations(self.trunk(condition))
        sample = randn_tensor(shape, generator=generators, device=condition.device, dtype=condition.dtype)
        steps = self.scheduler.timesteps
        if self._film_table is None:
            self._film_table = self.unet.film_of_steps(steps.to(condition.device))
        # A CUDA graph is for one number of rows, and needs a GPU, which a test may lack.
        retrace = self._rows != shape[0] and torch.cuda.is_available() if sample.is_cuda else self._rows == 0
        if retrace:
            inputs = sample if base_chunk is None else torch.cat([sample, base_chunk], dim=2)
            self._traced_unet, self._rows = self.unet.traced(inputs, film), shape[0]
        for step, film_of_step in zip(steps, self._film_table, strict=True):
            prediction = self._predicted(sample, film + film_of_step, base_chunk)
            # A scheduler returns a tuple only when it is asked to.
            step_output = self.scheduler.step(prediction, step, sample, generator=generators)  # pyright: ignore[reportArgumentType]
            sample = step_output.prev_sample  # pyright: ignore[reportAttributeAccessIssue]
        return sample

    def _predicted(self, noisy: Tensor, film: Tensor, base_chunk: Tensor | None) -> Tensor:
        """Prediction of the U-Net; with a given chunk, the sum of that and the predicted difference."""
        network = self._traced_unet or self.unet.modulated
        if base_chunk is None:
            return network(noisy, film)
        return base_chunk + network(torch.cat([noisy, base_chunk], dim=2), film)


class RefinedHead(Head):
    """Refined head: regression, trained first and then frozen; diffusion learns to correct its chunk."""

    def __init__(self, config: RefinedConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self._config = config
        self.diffusion = DiffusionHead(config.diffusion, condition, horizon, actions, refines=True)
        self.regression = RegressionHead(config.regression, condition, horizon, actions)

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        return self.diffusion.loss(condition, actions, generator, self._base_chunk(condition))

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        base_chunk, refines = self._base_chunk(condition), self._config.diffusion.inference_steps > 0
        return self.diffusion.sample(condition, generators, base_chunk) if refines else base_chunk

    def fits(self) -> list[Fit]:
        first = Fit([self.regression], self.regression.loss, self._config.regression_steps)
        return [first, Fit([self.diffusion], self.loss)]

    @torch.no_grad()
    def _base_chunk(self, condition: Tensor) -> Tensor:
        """The regression chunk (B, T, A), without dropout and gradients."""
        training = self.regression.training
        base_chunk = self.regression.eval().layers(condition)
        self.regression.train(training)
        return base_chunk
