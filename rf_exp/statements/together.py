from dataclasses import dataclass

from rf_exp.statements.deadline import Deadline
from rf_exp.statements.language.base import (
    MAX_WAIT_S,
    TOGETHER_S,
    MultiAgentStatement,
    Statement,
    Step,
    Words,
    agent_list,
)
from rf_exp.statements.language.notation import number

LARGEST_TOLERANCE_S = 10.0  # between starts that are called simultaneous
_JOINING_VERBS = ("put", "set", "lay", "stack", "bring")  # with `together`, these may mean to join objects
MIN_SUBGOAL_S = 2.0  # no subgoal is over so soon: `simultaneously within 2 s` is no deadline


@dataclass(frozen=True)
class Together(MultiAgentStatement):
    """Agents begin the same subgoal, or their whole plans, at most `within_s` apart (paper, section 3.2)."""

    kind = "temporal"
    patterns = (
        r"{agents} (?:both )?(?:{must} )?(?:both )?{verb} {object} {together}{within}",
        r"{agents} (?:{must} )?(?:perform|do|execute|carry out|start|begin) (?:(?:the|their) )?"
        r"(?:tasks?|actions?|motions?) {together}{within}",
    )

    verb: str | None = None
    object: str | None = None
    within_s: float = TOGETHER_S

    @property
    def sentence(self) -> str:
        action = Step(self.who[0], self.verb, self.object).action_text("perform their tasks")
        apart = " of each other" if self.within_s > MIN_SUBGOAL_S else ""
        return f"{agent_list(self.who)} must {action} simultaneously within {number(self.within_s)} s{apart}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        verb = words.verb()
        name = words.object() if verb else None
        says_together = words["together"] == "together"
        if says_together and verb and words["verb"].split()[0].rstrip("s") in _JOINING_VERBS:
            raise words.error(
                f"is not clear: to {words['verb']} {name} together may be to join it; say 'simultaneously'"
            )
        apart = "apart" in words
        within_s = words.seconds(TOGETHER_S, LARGEST_TOLERANCE_S if apart else MAX_WAIT_S)
        statement = cls(words.agents(), verb, name, within_s)
        if "s" in words and not apart and (says_together or within_s > MIN_SUBGOAL_S):
            deadline = Deadline(Step(statement.who[0], verb, name), within_s)
            apart_s = min(within_s, LARGEST_TOLERANCE_S)
            raise words.error(
                f"is not clear: is {within_s:g} s when they have to be done, or how far apart they begin? "
                f"Say '{deadline.sentence}' of each of them, or 'within {apart_s:g} s of each other'"
            )
        return statement


Together.samples = (
    Together((1, 2), "lift", "barrier", 0.5),
    Together((1, 2), "lift", "barrier", 5.0),
    Together((1, 2)),
)
