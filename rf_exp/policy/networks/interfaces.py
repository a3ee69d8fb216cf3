"""The interfaces of learning: an encoder of pictures, a head that predicts actions, a fit; hidden layers.

A policy is an encoder, a head and what lies between them (`rf_exp.policy.networks.policy`); it knows none by
name. A training is a list of fits (`rf_exp.policy.learning.training`), composed by encoder and head.
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
    """Linear layers between these sizes, each with Mish behind it."""
    for inputs, outputs in pairwise(sizes):
        yield from (nn.Linear(inputs, outputs), nn.Mish())
        if dropout:
            yield nn.Dropout(dropout)


@dataclass(frozen=True)
class Draw:
    """What one step of a training learns from, and its random numbers."""

    windows: NDArray[np.int64]  # (B,)
    weights: Tensor  # (B,) how much each counts, where what is learned is how often something is so
    rng: np.random.Generator
    generator: torch.Generator


@dataclass(frozen=True)
class Fit:
    """A stretch of training: these parts learn from this loss, and nothing else does."""

    parts: Sequence[nn.Module]
    loss: Callable[..., Tensor]  # of a Draw; of a head: of condition, actions and generator
    steps: int | None = None  # None: the training's own budget
    rate: float = 1.0  # of learning, as a multiple of the training's
    # Once it is learned and averaged; doing it again changes nothing.
    settle: Callable[[], None] = lambda: None
    # Of a first fit that other trainings may share: what decides it, beside data, view and pace of training.
    shared: Mapping[str, Any] | None = None


class Encoder(nn.Module):
    """Pictures (B, 3, H, W) in [-1, 1] -> features (B, F).

    Made with its configuration, a view and a spec. Who only computes features from pictures sets `features`
    and overrides `forward`. As it is it looks at nothing.
    """

    features = 0  # F; 0: looks at nothing

    def __init__(self, *_: Any) -> None:
        super().__init__()

    @property
    def size(self) -> int:
        """Numbers that the head is given of a picture."""
        return self.features

    @property
    def usual_rays(self) -> Tensor | None:
        """(S, K, 3, 4) of the cameras of S streams, where these usually stand; None: it need not know."""
        return None

    def see(self, pictures: Tensor, rays: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Features (B, F), and the places (B, M, 2), from 0 to 1, of what it finds there.

        `rays` (B, K, 3, 4) say where the K cameras stand, see `rf_exp.policy.inputs.pictures`. None: as
        usual, of one picture of each stream.
        """
        return self(pictures), None

    def perturbed(self, features: Tensor, generator: torch.Generator) -> Tensor:
        """Features (B, O, F) as the head learns from them."""
        return features

    def moved(self, features: Tensor, hands: Tensor) -> Tensor:
        """Features (B, O, F) where own hands (B, O, n, 3 * P + HEADING) are elsewhere than they are seen."""
        return features

    def conditioning(self, features: Tensor, context: Tensor) -> Tensor:
        """What the head is given (B, O, size) of features (B, O, F), where the context is (B, O, C)."""
        return features

    def offsets(self, features: Tensor, context: Tensor) -> Tensor:
        """From the TCPs of the own agents to where their grippers change next (B, O, n, 3), in m.

        `policy.goal_gate` asks for them, of an encoder whose configuration says `keypoints`, and of no other.
        """
        raise NotImplementedError

    def fit(self, examples: Windows) -> Fit | None:
        """Its own fit, before all others, after which it stays as it is; None: it learns with the head."""
        return None


class Head(nn.Module):
    """A condition (B, C) -> actions (B, T, A) in [-1, 1]; made with its configuration, and C, T and A."""

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        """What is made small: of conditions (B, C) and the actions (B, T, A) that were right there."""
        raise NotImplementedError

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        """Actions (B, T, A); all random numbers of row b come from `generators[b]`."""
        raise NotImplementedError

    def fits(self) -> list[Fit]:
        """How it is learned: all of it at once, unless it says otherwise."""
        return [Fit([self], self.loss)]
