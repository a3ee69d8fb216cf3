from dataclasses import dataclass

from rf_exp.statements.language.base import MultiAgentStatement, agent_list


@dataclass(frozen=True)
class ShareSpace(MultiAgentStatement):
    """Agents may use the same space at different times (paper, section 3.2)."""

    kind = "temporal"
    patterns = (
        r"{agents} {may} (?:share|use|occupy) (?:the )?(?:same |shared )?(?:space|area|region) {in turn}",
    )

    @property
    def sentence(self) -> str:
        return f"{agent_list(self.who)} may share the same space one after the other."


ShareSpace.samples = (ShareSpace((1, 2)),)
