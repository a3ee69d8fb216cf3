"""Custom policy head: ACT's transformer decoder (Zhao et al. 2023), with one learned query per action.

ACT's variational encoder is left out: its authors need it for human demonstrations, not for scripted ones.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy import Fit, Head, HeadConfig, add_head, bounded


@dataclass(frozen=True)
class ActConfig(HeadConfig):
    """Sizes of the decoder, smaller than in the paper, where `width` is 512."""

    width: int = bounded(1024, above=0)  # a multiple of `heads`
    heads: int = bounded(64, above=0)
    layers: int = bounded(32, above=0)
    tokens: int = bounded(256, above=0)  # that the condition is projected to
    dropout: float = bounded(least=0, below=1)
    rate: float = bounded(1e3, above=0)  # learning rate, as a multiple of that of the training


class Act(Head):
    """Transformer decoder: the queries of a chunk attend to one another and to the condition."""

    def __init__(self, config: ActConfig, condition: int, horizon: int, actions: int) -> None:
        super().__init__()
        self._rate, width = config.rate, config.width
        self.memory = nn.Sequential(
            nn.Linear(condition, config.tokens * width), nn.Unflatten(1, (config.tokens, width))
        )
        self.queries = nn.Parameter(torch.randn(horizon, width))
        layer = nn.TransformerDecoderLayer(
            width, config.heads, 4 * width, config.dropout, batch_first=True, norm_first=True
        )
        self.decoder = nn.TransformerDecoder(layer, config.layers, nn.LayerNorm(width))
        self.actions = nn.Linear(width, actions)

    def loss(self, condition: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
        return functional.l1_loss(self._chunk(condition).float(), actions)

    def sample(self, condition: Tensor, generators: list[torch.Generator]) -> Tensor:
        return self._chunk(condition)

    def fits(self) -> list[Fit]:
        return [Fit([self], self.loss, rate=self._rate)]

    def _chunk(self, condition: Tensor) -> Tensor:
        queries = self.queries.expand(len(condition), -1, -1)
        return self.actions(self.decoder(queries, self.memory(condition)))


add_head("act", ActConfig, Act)
