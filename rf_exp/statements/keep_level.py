from dataclasses import dataclass

from rf_exp.statements.language.base import Statement, Words, agent_name
from rf_exp.statements.language.notation import number

LEVEL_DEG = 10.0  # tolerance unless the sentence gives one
_LEVEL = r"(?:level|upright|horizontal)(?:,? (?:to )?within {deg})?"


@dataclass(frozen=True)
class KeepLevel(Statement):
    """An object, carried by one agent or by any, tilts by at most `within_deg` from its pose at the start."""

    kind = "logical"
    patterns = (
        rf"{{agent}} {{must}} (?:keep|hold|carry) {{object}} {_LEVEL}",
        rf"(?:keep {{object}}|{{object}} {{must}} (?:stay|remain|be|be kept|be held)) {_LEVEL}",
    )

    object: str
    within_deg: float = LEVEL_DEG
    agent: int | None = None

    @property
    def agents(self) -> tuple[int, ...]:
        return () if self.agent is None else (self.agent,)

    @property
    def sentence(self) -> str:
        within = f"level within {number(self.within_deg)} deg."
        if self.agent is None:
            return f"{self.object} must stay {within}"
        return f"{agent_name(self.agent)} must keep {self.object} {within}"

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agent = words.agent() if "agent" in words else None
        return cls(words.object(), words.quantity("deg", 90.0, LEVEL_DEG), agent)


KeepLevel.samples = (KeepLevel("lid", 5.0, 1), KeepLevel("pot"))
