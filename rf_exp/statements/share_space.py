"""Temporal: agents may use one space at different times (paper, section 3.2)."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.language.base import Form, OfAgents
from rf_exp.statements.language.vocabulary import listed
from rf_exp.types import Kind


@dataclass(frozen=True)
class ShareSpace(OfAgents):
    """Agents may use the same space at different times."""

    kind: ClassVar[Kind] = "temporal"

    @property
    def sentence(self) -> str:
        return f"{listed(self.who)} may share the same space one after the other."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"{agents} {may} (?:share|use|occupy) (?:the )?(?:same |shared )?(?:space|area|region) "
                r"{in turn}",
                lambda words: cls(words.agents()),
            ),
        )


ShareSpace.samples = (ShareSpace((1, 2)),)
