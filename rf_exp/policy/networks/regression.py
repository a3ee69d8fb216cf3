"""The regression head: a perceptron that makes a chunk of actions at once (absolute error)."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.config import RegressionConfig
from rf_exp.policy.networks.interfaces import Head
from rf_exp.policy.networks.layers import hidden


class RegressionHead(Head):
    """A perceptron with dropout."""

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
