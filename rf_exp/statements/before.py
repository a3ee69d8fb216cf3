from dataclasses import dataclass

from rf_exp.statements.language.base import Event, LiesOn, Statement, Step, Words, agent_name
from rf_exp.statements.language.notation import number
from rf_exp.types import ANY_AGENT

_DOES = r"{does then} {object then}"


@dataclass(frozen=True)
class Before(Statement):
    """An event is over, and `wait_s` have passed, before an agent begins a part (paper, section 3.2)."""

    kind = "temporal"
    patterns = (
        r"{did first} before {starts then}",
        r"before {starts then}, {did first}",
        r"(?:first,? )?{did first},? (?:and )?then,? "
        r"(?:{starts then}|{object then} (?:{must} be|is) {participle then} by {agent then})",
        rf"{{agent then}} (?:(?:{{must}} )?(?:only )?{_DOES}|{{may}} only {_DOES}|"
        rf"(?:{{must}}|{{may}}) {_DOES} only) (?:after|once) {{ended first}}",
        rf"(?:only )?(?:after|once) {{ended first}},? {{agent then}} {{must}} {_DOES}",
        rf"{{agent then}} {{not}} (?:{_DOES}|{{begin}}) (?:before|until) {{ended first}}",
        r"{agent then} (?:{must} )?waits? until {ended first}"
        r"(?: before (?:it )?(?:{may} )?(?:{does then}|{doing then}) {object then})?",
        r"{agent then} (?:{must} )?waits? for {agent first} to (?:{does first} {object first}|"
        r"(?:be done|finish|complete)(?: {task}| {doing first} {object first})?)",
        r"{agent then} (?:{must} )?waits? (?:for )?(?:at least )?{s} after (?:{ended first}|{agent first})",
        rf"{{agent then}} (?:{{must}} )?{_DOES} at least {{s}} after {{ended first}}",
    )

    first: Event
    then: Step
    wait_s: float = 0.0

    @property
    def sentence(self) -> str:
        first, then, agent = self.first, self.then, agent_name(self.then.agent)
        if self.wait_s:
            action = f"{then.action_text('')} at least" if then.verb else "wait"
            return f"{agent} must {action} {number(self.wait_s)} s after {first.end_text}."
        if isinstance(first, LiesOn):
            action = f"{then.action_text('')} only after" if then.verb else "wait until"
            return f"{agent} must {action} {first.end_text}."
        begins = f"may {then.action_text('')}" if then.verb else "begins"
        action = first.action_text("complete its task")
        return f"{agent_name(first.agent)} must {action} before {agent} {begins}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        first, then = words.event("first"), words.step("then")
        if isinstance(first, Step) and first.agent == then.agent != ANY_AGENT:
            words.require_two((then.agent,))
        return cls(first, then, words.seconds(0.0))


Before.samples = (
    Before(Step(2, "lift", "lid"), Step(1, "place", "steak")),
    Before(Step(2), Step(1)),
    Before(Step(2, "lift", "lid"), Step(1)),
    Before(LiesOn("lid"), Step(1)),
    Before(Step(2, "lift", "lid"), Step(1), 2.0),
)
