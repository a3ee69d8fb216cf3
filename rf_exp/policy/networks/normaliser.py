"""Joint positions and actions to and from [-1, 1], by their range in the demonstrations."""

import torch
from torch import Tensor, nn

LEAST_RANGE = 0.02  # rad or m: a joint that hardly moves is centred, its noise not blown up to [-1, 1]


class Range(nn.Module):
    """Affine map of the last axis (D) from its smallest and largest value to [-1, 1]."""

    centre: Tensor
    radius: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("centre", torch.zeros(size))
        self.register_buffer("radius", torch.ones(size))

    def fit(self, values: Tensor) -> None:
        """Take the range of values (K, D); it is at least `LEAST_RANGE` wide."""
        low, high = values.amin(dim=0), values.amax(dim=0)
        self.centre.copy_((low + high) / 2)
        self.radius.copy_(((high - low) / 2).clamp(min=LEAST_RANGE / 2))

    def normalise(self, values: Tensor) -> Tensor:
        return (values - self.centre) / self.radius

    def restore(self, values: Tensor) -> Tensor:
        return values * self.radius + self.centre


class Normaliser(nn.Module):
    """What a policy remembers of its data: the ranges, and how fast targets moved in a control step."""

    fastest: Tensor  # (A,) largest change of each action between two control steps of a demonstration

    def __init__(self, proprio_size: int, action_size: int, context_size: int = 0, features: int = 0) -> None:
        super().__init__()
        self.proprio, self.action = Range(proprio_size), Range(action_size)
        self.context, self.features = Range(context_size), Range(features)
        self.register_buffer("fastest", torch.zeros(action_size))


def largest_change(action: Tensor, within: Tensor) -> Tensor:
    """(A,) largest change between neighbouring rows of action (K, A).

    `within` (K - 1,) says which neighbours belong to one episode.
    """
    change = action.diff(dim=0).abs()[within]
    return change.amax(dim=0) if len(change) else torch.zeros_like(action[0])
