"""Account of an episode or a rollout, as values: violations, contacts, and unmet conditions of a failure.

    failed: held by both arms (since 4.10 s), lifted (never: 0.02 m, best 0.11, asked > 0.15);
    at best 3 of 4 (3.95 s); agents 1 and 2 touched (2.30 s, 14 steps); barrier dropped (4.10 s)

All times are in seconds since the start of the episode.
"""

from dataclasses import dataclass

from rf_exp.findings.finding import Violation

HELD_TOO_SHORT = "all conditions held, but not for long"
TOUCHED = "all conditions held, but arms had touched"
NOTHING_EXECUTED = "nothing was carried out"


def bound_text(bound: float, above: bool) -> str:
    """Text of a bound, `> 0.15` or `< 0.15`. To three figures: bounds vary with sizes."""
    return f"{'>' if above else '<'} {bound:.3g}"


@dataclass(frozen=True)
class Unmet:
    """A condition of success that did not hold at the end, with its number, if it has one."""

    name: str
    since_s: float = 0.0  # since when it has not held; 0: it never did
    value: float | None = None  # at the end
    best: float | None = None  # at any step
    bound: float = 0.0
    unit: str = ""
    above: bool = False  # the value should be above the bound, otherwise below it

    @property
    def sentence(self) -> str:
        """The condition, with all that depends on the scene in parentheses."""
        parts = [f"since {self.since_s:.2f} s" if self.since_s else "never"]
        if self.value is not None:
            better = self.best is not None and f"{self.best:.2g}" != f"{self.value:.2g}"
            best = f", best {self.best:.2g}" if better and not self.since_s else ""
            requirement = bound_text(self.bound, self.above)
            parts += [f"{self.value:.2g} {self.unit}{best}, asked {requirement}"]
        return f"{self.name} ({': '.join(parts)})"


@dataclass(frozen=True)
class Closest:
    """The moment at which most conditions held at once."""

    holding: int  # conditions
    of: int
    time_s: float  # the first such moment; 0 where none ever held
    steps: int  # longest run of control steps in which all conditions held

    @property
    def score(self) -> float:
        """Progress of a failure, from 0 to 1: the fraction of the conditions that held at once.

        Holding them for the required time counts as one more, which no failure meets: only success is 1.
        """
        return self.holding / (self.of + 1)

    @property
    def sentence(self) -> str:
        duration = f", for {self.steps} steps" if self.steps else ""
        when = f" ({self.time_s:.2f} s{duration})" if self.holding else ""
        return f"at best {self.holding} of {self.of}{when}"


NO_STEPS = Closest(0, 0, 0.0, 0)  # of an attempt without a step


@dataclass(frozen=True)
class Touch:
    """Two arms that touched."""

    agents: tuple[int, int]
    time_s: float  # for the first time
    steps: int  # control steps

    @property
    def kind(self) -> str:
        return f"agents {self.agents[0]} and {self.agents[1]} touched"

    @property
    def sentence(self) -> str:
        return f"{self.kind} ({self.time_s:.2f} s, {self.steps} steps)"


@dataclass(frozen=True)
class ClutterContact:
    """Clutter that an arm, or a carried object, touched."""

    who: str  # agent<k> or an object
    clutter: str
    time_s: float  # for the first time
    steps: int  # control steps

    @property
    def kind(self) -> str:
        return f"{self.who} touched clutter"

    @property
    def sentence(self) -> str:
        return f"{self.who} touched {self.clutter} ({self.time_s:.2f} s, {self.steps} steps)"


@dataclass(frozen=True)
class Lost:
    """An object that was lost."""

    object: str
    how: str  # dropped | out of reach | off the table
    time_s: float  # for the first time

    @property
    def kind(self) -> str:
        return f"{self.object} {self.how}"

    @property
    def sentence(self) -> str:
        return f"{self.kind} ({self.time_s:.2f} s)"


@dataclass(frozen=True)
class Account:
    """Account of one episode or rollout. `unmet`, `closest` and `lost` are of failures only."""

    rejections: tuple[Violation, ...] = ()  # that ended a proposal, in order
    violations: tuple[Violation, ...] = ()  # of a rollout: the first of each pair of agents
    touches: tuple[Touch, ...] = ()
    unmet: tuple[Unmet, ...] = ()
    closest: Closest | None = None
    lost: tuple[Lost, ...] = ()
    refused: Violation | None = None  # why a success does not count: a disturbed arm has moved an object
    ended: str = ""  # reason for ending before it was judged
    clutter_contacts: tuple[ClutterContact, ...] = ()

    @property
    def reason(self) -> str:
        return "; ".join(self.parts)

    @property
    def parts(self) -> list[str]:
        """Reasons for the failure, one by one."""
        if self.refused is not None:
            return [f"refused: {self.refused.sentence}"]
        if self.ended:
            return [self.ended]
        closest = self.closest
        if self.unmet:
            parts = ["failed: " + ", ".join(condition.sentence for condition in self.unmet)]
            parts += [closest.sentence] if closest is not None else []
        else:
            steps = f" ({closest.steps} steps)" if closest is not None and closest != NO_STEPS else ""
            parts = [f"failed: {self._summary}{steps}"]
        parts += [event.sentence for event in (*self.touches, *self.clutter_contacts, *self.lost)]
        if self.rejections:  # the first says what went wrong; the last, why that could not be repaired
            first, last, count = self.rejections[0], self.rejections[-1], len(self.rejections)
            parts.append(f"the first violation of {count}: {first.sentence}")
            parts += [f"the last: {last.sentence}"] if last.sentence != first.sentence else []
        return parts

    @property
    def kind(self) -> str:
        """The reason without what depends on the scene: equal failures have equal texts."""
        if self.refused is not None:
            return f"refused: {self.refused.kind}"
        if self.ended:
            return self.ended
        failed = ", ".join(condition.name for condition in self.unmet) or self._summary
        clutter = dict.fromkeys(contact.kind for contact in self.clutter_contacts)
        events = [touch.kind for touch in self.touches] + [*clutter]
        events += [event.kind for event in (*self.lost, *self.rejections[:1])]
        return "; ".join([failed, *events])

    @property
    def _summary(self) -> str:
        """Reason for a failure without an unmet condition at the end."""
        if self.closest == NO_STEPS:
            return NOTHING_EXECUTED
        return TOUCHED if self.touches else HELD_TOO_SHORT
