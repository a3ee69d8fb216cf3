"""The transition predictor: at which subgoal each own agent is, and whether it may go on.

Both are part of the context, its last numbers, and are predicted from all the rest of it.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.networks.layers import hidden


class TransitionPredictor(nn.Module):
    """Of n own agents: a condition (B, C) -> which of K subgoals, and whether it may go on (n, K + 1)."""

    def __init__(self, condition: int, agents: int, size: int, dropout: float) -> None:
        """`size` is K + 1."""
        super().__init__()
        self._agents, self._size = agents, agents * size
        self.layers = nn.Sequential(*hidden([condition, 256, 256], dropout), nn.Linear(256, self._size))

    def hide(self, context: Tensor) -> Tensor:
        """Context (..., C) without what is predicted."""
        return functional.pad(context[..., : -self._size], (0, self._size))

    def tell(self, context: Tensor, numbers: Tensor, free: Tensor) -> Tensor:
        """Context (B, O, C) with the subgoals (B, n) of the own agents and whether they may go on (B, n)."""
        subgoal = functional.one_hot(numbers, self._size // self._agents - 1)
        phase = torch.cat([subgoal, free[..., None]], dim=2).flatten(1).to(context.dtype)
        said = phase[:, None].expand(-1, context.shape[1], -1)
        return torch.cat([context[..., : -self._size], said], dim=2)

    def loss(self, condition: Tensor, context: Tensor, weights: Tensor) -> Tensor:
        """Cross entropy, of conditions without what is said in the context; windows count by weights (B,)."""
        found = self.layers(condition).float().unflatten(1, (self._agents, -1)).flatten(0, 1)
        phase = context[:, -1, -self._size :].reshape(found.shape)
        subgoal = functional.cross_entropy(found[:, :-1], phase[:, :-1], reduction="none")
        free = functional.binary_cross_entropy_with_logits(found[:, -1], phase[:, -1], reduction="none")
        return (weights.repeat_interleave(self._agents) * (subgoal + free)).mean()

    def chances(self, condition: Tensor) -> Tensor:
        """How likely each is at each subgoal and, in the last column, that it may go on (B, n, K + 1)."""
        found = self.layers(condition).unflatten(1, (self._agents, -1))
        return torch.cat([found[..., :-1].softmax(dim=2), found[..., -1:].sigmoid()], dim=2)
