"""A named mistake."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rf_exp.datagen.brain.protocol import Question
from rf_exp.statements import Proposal

Change = Callable[[Proposal, Question, np.random.Generator], Proposal | None]


@dataclass(frozen=True)
class Fault:
    """A named mistake."""

    name: str
    change: Change  # None from it: does not apply here
    breaks: bool  # True: something that was demanded cannot hold; False: a demand is left out

    @property
    def description(self) -> str:
        return " ".join((self.change.__doc__ or "").split())


def fault(*, breaks: bool) -> Callable[[Change], Fault]:
    """Makes a fault of what changes a proposal; it has its name."""
    return lambda change: Fault(change.__name__, change, breaks)  # pyright: ignore[reportFunctionMemberAccess]
