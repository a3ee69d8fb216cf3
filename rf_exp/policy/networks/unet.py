"""Diffusion Policy's conditional 1-D U-Net, put together from diffusers' blocks.

Structure: Chi et al., "Diffusion Policy", CNN variant; the paper's section 4 uses it at a horizon of 8.
Every residual block is modulated by scale and bias (FiLM) from the diffusion step and the observation.
All FiLM projections live in one linear layer: it is one matrix product instead of one for each block,
and because a sum of two products, W [step; observation] = W_step step + W_obs observation, the step part
is a table over the diffusion steps and the observation part is computed once for an observation.
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
from torch import Tensor, nn
from torch.nn.functional import mish

from rf_exp.errors import ArgumentError

STEP_SIZE = 128  # width of the embedding of a diffusion step
GROUPS = 8  # of every GroupNorm, fixed in diffusers' blocks


class FilmBlock(ResidualTemporalBlock1D):
    """A residual block that reads its scale and bias from its part of the U-Net's FiLM vector."""

    def __init__(self, in_channels: int, out_channels: int, first: int) -> None:
        super().__init__(in_channels, out_channels, embed_dim=1)
        del self.time_emb, self.time_emb_act  # the U-Net projects for all blocks together
        self.first, self.channels = first, out_channels

    def forward(self, inputs: Tensor, t: Tensor) -> Tensor:
        """Inputs (B, in, T) and the FiLM vector of the whole U-Net `t` (B, F) -> (B, out, T)."""
        scale, bias = t[:, self.first : self.first + 2 * self.channels, None].chunk(2, dim=1)
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
        given: int = 0,  # channels along time that are known, beside the noisy actions
    ) -> None:
        super().__init__()
        if len(channels) < 2 or any(width <= 0 or width % GROUPS for width in channels):
            raise ArgumentError(
                f"unet channels {tuple(channels)}; expected at least two levels, each a multiple of {GROUPS}"
            )
        self._film_size = 0
        self.step_features = Timesteps(STEP_SIZE, flip_sin_to_cos=False, downscale_freq_shift=1)
        self.step_embedding = TimestepEmbedding(STEP_SIZE, 4 * STEP_SIZE, "mish", out_dim=STEP_SIZE)
        down = [DownResnetBlock1D(a, b) for a, b in pairwise((action_size + given, *channels))]
        down[-1].downsample = None  # the deepest level keeps its length
        up = [UpResnetBlock1D(b, a, add_upsample=True) for a, b in reversed(list(pairwise(channels)))]
        self.down = nn.ModuleList(self._modulated(block) for block in down)
        self.middle = self._modulated(MidResTemporalBlock1D(channels[-1], channels[-1], embed_dim=1))
        self.up = nn.ModuleList(self._modulated(block) for block in up)
        self.out = OutConv1DBlock(GROUPS, action_size, channels[0], "mish")
        if given:  # what is learned is added to it, from nothing on
            nn.init.zeros_(self.out.final_conv1d_2.weight)
            nn.init.zeros_(self.out.final_conv1d_2.bias)  # pyright: ignore[reportArgumentType]
        self.film = nn.Linear(STEP_SIZE + observation_size, self._film_size)

    def _modulated(self, block: nn.Module) -> nn.Module:
        """The block of diffusers with its residual blocks exchanged for modulated ones."""
        plain: list[ResidualTemporalBlock1D] = list(block.resnets)  # pyright: ignore[reportArgumentType]
        blocks = []
        for resnet in plain:
            conv = resnet.conv_in.conv1d
            blocks.append(FilmBlock(conv.in_channels, conv.out_channels, self._film_size))
            self._film_size += 2 * conv.out_channels
        block.resnets = nn.ModuleList(blocks)
        return block

    def film_of_steps(self, steps: Tensor) -> Tensor:
        """The step's share of the FiLM vector: diffusion steps (S,) -> (S, F)."""
        weight = self.film.weight[:, :STEP_SIZE]
        return mish(self.step_embedding(self.step_features(steps).to(weight.dtype))) @ weight.T

    def film_of_observations(self, observation: Tensor) -> Tensor:
        """The observation's share of the FiLM vector, bias included: (B, C) -> (B, F)."""
        return nn.functional.linear(mish(observation), self.film.weight[:, STEP_SIZE:], self.film.bias)

    def modulated(self, sample: Tensor, film: Tensor) -> Tensor:
        """The network for noisy actions with what is given (B, T, A + G) and FiLM (B, F) -> (B, T, A)."""
        hidden, skips = sample.transpose(1, 2), []
        for block in self.down:
            hidden, states = block(hidden, film)
            skips.append(states)
        hidden = self.middle(hidden, film)
        for block in self.up:
            hidden = block(hidden, skips.pop(), film)
        return self.out(hidden).transpose(1, 2)

    def quick(self, sample: Tensor, film: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        """`modulated` for values like these in any number of rows, without Python between its operations.

        They are the same to the last bit; a single row on a CPU takes a third of the time by it
        (benchmarks/policy_call.py). Weights are the module's own, in the mode that it is in.
        """
        with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
            warnings.simplefilter("ignore")  # of sizes that depend on the data: these depend on the network
            shapes = (torch.zeros(2, *sample.shape[1:]), torch.zeros(2, *film.shape[1:]))
            traced = torch.jit.trace_module(self, {"modulated": shapes}, check_trace=False)
        return traced.modulated  # pyright: ignore[reportReturnType]

    def forward(self, sample: Tensor, steps: Tensor, observation: Tensor) -> Tensor:
        """Noisy actions (B, T, A), diffusion steps (B,), observation (B, C) -> prediction (B, T, A).

        T must be a multiple of 2 ** (levels - 1). Reference computation: sampling and training use the
        parts above, which a test holds to this one.
        """
        embedding = self.step_embedding(self.step_features(steps).to(sample.dtype))
        return self.modulated(sample, self.film(mish(torch.cat([embedding, observation], dim=1))))
