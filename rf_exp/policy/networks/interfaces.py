"""Interfaces of learning: an encoder of pictures, a head that predicts actions, a fit; hidden layers.

A policy (`rf_exp.policy.networks.policy`) connects an encoder and a head by these interfaces alone. A
training is a list of fits (`rf_exp.policy.learning.training`), composed by encoder and head.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rf_exp.policy.examples.windows import Windows


def hidden(sizes: Sequence[int], dropout: float = 0.0) -> Iterator[nn.Module]:
    """Linear layers between these sizes, each followed by Mish and, if given, dropout."""
    for inputs, outputs in pairwise(sizes):
        yield from (nn.Linear(inputs, outputs), nn.Mish())
        if dropout:
            yield nn.Dropout(dropout)


@dataclass(frozen=True)
class Draw:
    """Windows of one training step, and its random number generators."""

    windows: NDArray[np.int64]  # (B,)
    weights: Tensor  # (B,) importance of each window, for losses that estimate probabilities
    rng: np.random.Generator
    generator: torch.Generator


@dataclass(frozen=True)
class Fit:
    """A stretch of training in which only `parts` learn, from `loss`."""

    parts: Sequence[nn.Module]
    loss: Callable[..., Tensor]  # takes a Draw; from a head: condition, actions, generator
    steps: int | None = None  # None: the training's own budget
    rate: float = 1.0  # learning rate, as a multiple of the training's
    finish: Callable[[], None] = lambda: None
    # Called once the fit is done and its weights are averaged; idempotent.
    cache_key: Mapping[str, Any] | None = None
    # For a first fit that other trainings may share: what it depends on beside data, view and the training
    # (without its budget).


class Encoder(nn.Module):
    """Encoder: pictures (B, 3, H, W) in [-1, 1] -> features (B, F).

    Constructed with its configuration, a view and a spec. A subclass that only computes features from
    pictures sets `features` and overrides `forward`. The base class uses no pictures.
    """

    features = 0  # F; 0: no pictures are used

    def __init__(self, *_: Any) -> None:
        super().__init__()

    @property
    def size(self) -> int:
        """Number of values per frame that `conditioning` gives."""
        return self.features

    @property
    def usual_rays(self) -> Tensor | None:
        """(S, K, 3, 4) of the cameras of S streams, as usually mounted; None: it needs no rays."""
        return None

    def encode(self, pictures: Tensor, rays: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Features (B, F), and the places (B, M, 2), from 0 to 1, of detected points, if any.

        `rays` (B, K, 3, 4) are those of the K cameras, see `rf_exp.policy.inputs.pictures`. None: the usual
        ones, for one picture of each stream.
        """
        return self(pictures), None

    def perturbed(self, features: Tensor, generator: torch.Generator) -> Tensor:
        """Features (B, O, F) with the noise of the training of the head."""
        return features

    def displaced(self, features: Tensor, gripper_offsets: Tensor) -> Tensor:
        """Features (B, O, F) with the own grippers displaced by offsets (B, O, n, 3 * P + HEADING_SIZE)."""
        return features

    def conditioning(self, features: Tensor, context: Tensor) -> Tensor:
        """Inputs of the head (B, O, size) from features (B, O, F) and context (B, O, C)."""
        return features

    def offsets(self, features: Tensor, context: Tensor) -> Tensor:
        """Offsets (B, O, n, 3), in m, from the TCPs of the own agents to their next keyframes.

        For `policy.goal_gate`, which requires an encoder whose configuration has `keypoints`.
        """
        raise NotImplementedError

    def fit(self, examples: Windows) -> Fit | None:
        """Its own fit, before all others, after which it is frozen; None: it is trained with the head."""
        return None


class Head(nn.Module):
    """Head: condition (B, C) -> actions (B, T, A) in [-1, 1]; constructed with configuration, C, T and A."""

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        """Training loss for conditions (B, C) and demonstrated actions (B, T, A)."""
        raise NotImplementedError

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        """Actions (B, T, A); all random numbers of row b come from `generators[b]`."""
        raise NotImplementedError

    def fits(self) -> list[Fit]:
        """The fits of its training, in order; by default a single one of the whole head."""
        return [Fit([self], self.loss)]
