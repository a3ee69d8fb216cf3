from dataclasses import dataclass

from rf_exp.statements.language.base import MultiAgentStatement, Statement, Step, Words, agent_list
from rf_exp.statements.language.verbs import VERBS

_WHEN = r"(?: (?:when|while) {doing} {object})?"


@dataclass(frozen=True)
class SameHeight(MultiAgentStatement):
    """Agents that carry one object together raise it by the same height (paper, section 3.2)."""

    kind = "logical"
    patterns = (
        r"{agents} (?:both )?(?:{must} )?(?:both )?(?:keep|maintain|have|hold) (?:the |a |an )?"
        rf"{{consistent}} (?:gripper )?heights?{_WHEN}",
        r"keep (?:the )?gripper heights? (?:{consistent}|the same)(?: (?:between|of|for) {agents})?" + _WHEN,
    )

    verb: str | None = None
    object: str | None = None

    @property
    def sentence(self) -> str:
        phase = f" when {VERBS[self.verb].gerund} {self.object}" if self.verb else ""
        return f"{agent_list(self.who)} must keep a consistent gripper height{phase}."

    @property
    def phase(self) -> tuple[Step, ...]:
        """The parts of the plans in which it has to hold; the whole plans without a verb."""
        return tuple(Step(agent, self.verb, self.object) for agent in self.who)

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        verb = words.verb()
        return cls(words.agents(), verb, words.object() if verb else None)


SameHeight.samples = (SameHeight((1, 2)),)
