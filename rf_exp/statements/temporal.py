"""Temporal statements: order, simultaneity, deadlines (paper, section 3.2)."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.statements.base import Form, OfAgents, Statement
from rf_exp.statements.events import Event, LiesOn, Step, named
from rf_exp.statements.notation import MAX_WAIT_S, TOGETHER_S, Words, number
from rf_exp.statements.vocabulary import agent_name, listed
from rf_exp.types import Kind

LARGEST_TOLERANCE_S = 10.0  # between beginnings that are called simultaneous
_JOINS = ("put", "set", "lay", "stack", "bring")  # with `together`
SHORT_S = 2.0  # nothing is over so soon: `simultaneously within 2 s` is no deadline


@dataclass(frozen=True)
class Before(Statement):
    """Something is over before an agent begins something, with a pause of `wait_s` between."""

    kind: ClassVar[Kind] = "temporal"

    first: Event
    then: Step
    wait_s: float = 0.0

    @property
    def agents(self) -> tuple[int, ...]:
        first = (self.first.agent,) if isinstance(self.first, Step) else ()
        return (*first, self.then.agent)

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return *named(self.first), *named(self.then)

    @property
    def sentence(self) -> str:
        first, then, who = self.first, self.then, agent_name(self.then.agent)
        if self.wait_s:
            pause = f"{number(self.wait_s)} s"
            if then.verb:
                return f"{who} must {then.verb} {then.object} at least {pause} after {first.ended}."
            return f"{who} must wait {pause} after {first.ended}."
        if isinstance(first, LiesOn):
            what = f"{then.verb} {then.object} only after" if then.verb else "wait until"
            return f"{who} must {what} {first.ended}."
        return f"{first.must} before {then.begins}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        does = r"{does then} {object then}"
        return (
            Form(r"{did first} before {starts then}", cls._read),
            Form(r"before {starts then}, {did first}", cls._read),
            Form(
                r"(?:first,? )?{did first},? (?:and )?then,? "
                r"(?:{starts then}|{object then} (?:{must} be|is) {participle then} by {agent then})",
                cls._read,
            ),
            Form(
                rf"{{agent then}} (?:(?:{{must}} )?(?:only )?{does}|{{may}} only {does}|"
                rf"(?:{{must}}|{{may}}) {does} only) (?:after|once) {{ended first}}",
                cls._read,
            ),
            Form(
                rf"(?:only )?(?:after|once) {{ended first}},? {{agent then}} {{must}} {does}",
                cls._read,
            ),
            Form(rf"{{agent then}} {{not}} (?:{does}|{{begin}}) (?:before|until) {{ended first}}", cls._read),
            Form(
                r"{agent then} (?:{must} )?waits? until {ended first}"
                r"(?: before (?:it )?(?:{may} )?(?:{does then}|{doing then}) {object then})?",
                cls._read,
            ),
            Form(
                r"{agent then} (?:{must} )?waits? for {agent first} to "
                r"(?:{does first} {object first}|"
                r"(?:be done|finish|complete)(?: {task}| {doing first} {object first})?)",
                cls._read,
            ),
            Form(
                r"{agent then} (?:{must} )?waits? (?:for )?(?:at least )?{s} after "
                r"(?:{ended first}|{agent first})",
                cls._read,
            ),
            Form(
                rf"{{agent then}} (?:{{must}} )?{does} at least {{s}} after {{ended first}}",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        first, then = words.event("first"), words.step("then")
        if isinstance(first, Step) and first.agent == then.agent:
            words.several((then.agent,))
        return cls(first, then, words.seconds(0.0))


@dataclass(frozen=True)
class Together(OfAgents):
    """Agents begin the same thing, or all that they do, at most `within_s` apart."""

    kind: ClassVar[Kind] = "temporal"

    verb: str | None = None
    object: str | None = None
    within_s: float = TOGETHER_S

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return ((self.object, None),) if self.object else ()

    @property
    def sentence(self) -> str:
        what = f"{self.verb} {self.object}" if self.verb else "perform their tasks"
        apart = " of each other" if self.within_s > SHORT_S else ""
        return f"{listed(self.who)} must {what} simultaneously within {number(self.within_s)} s{apart}."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"{agents} (?:both )?(?:{must} )?(?:both )?{verb} {object} {together}{within}",
                cls._read,
            ),
            Form(
                r"{agents} (?:{must} )?(?:perform|do|execute|carry out|start|begin) (?:(?:the|their) )?"
                r"(?:tasks?|actions?|motions?) {together}{within}",
                cls._read,
            ),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        verb = words.verb()
        name = words.object() if verb else None
        loosely = words["together"] == "together"
        if loosely and verb and words["verb"].split()[0].rstrip("s") in _JOINS:
            raise words.refused(
                f"is not clear: to {words['verb']} {name} together may be to join it; say 'simultaneously'"
            )
        apart = "apart" in words
        within_s = words.seconds(TOGETHER_S, LARGEST_TOLERANCE_S if apart else MAX_WAIT_S)
        stated = cls(words.agents(), verb, name, within_s)
        if "s" in words and not apart and (loosely or within_s > SHORT_S):
            alone = Deadline(Step(stated.who[0], verb, name), within_s)
            apart_s = min(within_s, LARGEST_TOLERANCE_S)
            raise words.refused(
                f"is not clear: is {within_s:g} s when they have to be done, or how far apart they begin? "
                f"Say '{alone.sentence}' of each of them, or 'within {apart_s:g} s of each other'"
            )
        return stated


@dataclass(frozen=True)
class Deadline(Statement):
    """A part of an agent's plan is over in time, counted from the start of the plan."""

    kind: ClassVar[Kind] = "temporal"

    step: Step
    within_s: float

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.step.agent,)

    @property
    def names(self) -> tuple[tuple[str, str | None], ...]:
        return named(self.step)

    @property
    def sentence(self) -> str:
        what = f"{self.step.verb} {self.step.object}" if self.step.verb else "finish"
        return f"{agent_name(self.step.agent)} must {what} within {number(self.within_s)} s."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (
            Form(
                r"{agent} (?:(?:{must} )?{end}(?: {task}| {doing} {object})?|{must} be done) within {s}",
                cls._read,
            ),
            Form(r"{agent} (?:{must} )?{does} {object} within {s}", cls._read),
        )

    @classmethod
    def _read(cls, words: Words) -> Statement:
        return cls(words.step(), words.seconds())


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


Before.samples = (
    Before(Step(2, "lift", "lid"), Step(1, "place", "steak")),
    Before(Step(2), Step(1)),
    Before(Step(2, "lift", "lid"), Step(1)),
    Before(LiesOn("lid"), Step(1)),
    Before(Step(2, "lift", "lid"), Step(1), 2.0),
)
Together.samples = (
    Together((1, 2), "lift", "barrier", 0.5),
    Together((1, 2), "lift", "barrier", 5.0),
    Together((1, 2)),
)
Deadline.samples = (Deadline(Step(1), 10.0), Deadline(Step(1, "lift", "barrier"), 10.0))
ShareSpace.samples = (ShareSpace((1, 2)),)
