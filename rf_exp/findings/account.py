"""How an episode or a rollout went, as values: what was violated and touched, and of a failure what failed.

    failed: held by both arms (since 4.10 s), lifted (never: 0.02 m, best 0.11, asked > 0.15);
    at best 3 of 4 (3.95 s); agents 1 and 2 touched (2.30 s, 14 steps); barrier dropped (4.10 s)

All times are in seconds since the start of the episode.
"""

from dataclasses import dataclass

from rf_exp.findings.finding import Violation

TOO_SHORT = "all conditions held, but not for long"
TOUCHED = "all conditions held, but arms had touched"
IDLE = "nothing was carried out"


def bound_text(bound: float, above: bool) -> str:
    """What a number should be: above a bound, or below it. To three figures: bounds vary with sizes."""
    return f"{'>' if above else '<'} {bound:.3g}"


@dataclass(frozen=True)
class Unmet:
    """A condition of success that did not hold at the end, with its number, if it has one."""

    name: str
    since_s: float = 0.0  # since when it does not hold; 0: it never did
    value: float | None = None  # at the end
    best: float | None = None  # at any step
    bound: float = 0.0
    unit: str = ""
    above: bool = False  # the value should be above the bound, otherwise below it

    @property
    def sentence(self) -> str:
        """The condition, and in parentheses all that differs from scene to scene."""
        parts = [f"since {self.since_s:.2f} s" if self.since_s else "never"]
        if self.value is not None:
            better = self.best is not None and f"{self.best:.2g}" != f"{self.value:.2g}"
            best = f", best {self.best:.2g}" if better and not self.since_s else ""
            asked = bound_text(self.bound, self.above)
            parts += [f"{self.value:.2g} {self.unit}{best}, asked {asked}"]
        return f"{self.name} ({': '.join(parts)})"


@dataclass(frozen=True)
class Closest:
    """When most conditions held at once."""

    holding: int  # conditions
    of: int
    time_s: float  # the first such moment; 0 where none ever held
    steps: int  # control steps for which all of them held, at most

    @property
    def score(self) -> float:
        """How far a failure came, from 0 to 1: the part of the conditions that held at once.

        That they hold for as long as is asked is one more, which no failure meets: only success is 1.
        """
        return self.holding / (self.of + 1)

    @property
    def sentence(self) -> str:
        long = f", for {self.steps} steps" if self.steps else ""
        when = f" ({self.time_s:.2f} s{long})" if self.holding else ""
        return f"at best {self.holding} of {self.of}{when}"


NOTHING = Closest(0, 0, 0.0, 0)  # of an attempt without one step


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
    """Clutter that an arm, or what one carried, touched."""

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
    """A thing that was lost."""

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
    """Of one episode or rollout. `unmet`, `closest` and `lost` tell of failures alone."""

    rejections: tuple[Violation, ...] = ()  # that ended a proposal, in their order
    violations: tuple[Violation, ...] = ()  # of a rollout: the first of each pair of agents
    touches: tuple[Touch, ...] = ()
    unmet: tuple[Unmet, ...] = ()
    closest: Closest | None = None
    lost: tuple[Lost, ...] = ()
    refused: Violation | None = None  # why a success is none: what a disturbed arm has moved
    ended: str = ""  # in the words of who ended it before it was judged
    clutter_contacts: tuple[ClutterContact, ...] = ()

    @property
    def reason(self) -> str:
        return "; ".join(self.parts)

    @property
    def parts(self) -> list[str]:
        """Why it failed, part by part."""
        if self.refused is not None:
            return [f"refused: {self.refused.sentence}"]
        if self.ended:
            return [self.ended]
        closest = self.closest
        if self.unmet:
            parts = ["failed: " + ", ".join(each.sentence for each in self.unmet)]
            parts += [closest.sentence] if closest is not None else []
        else:
            steps = f" ({closest.steps} steps)" if closest is not None and closest != NOTHING else ""
            parts = [f"failed: {self._briefly}{steps}"]
        parts += [each.sentence for each in (*self.touches, *self.clutter_contacts, *self.lost)]
        if self.rejections:  # the first says what went wrong; the last, why that could not be mended
            first, last, many = self.rejections[0], self.rejections[-1], len(self.rejections)
            parts.append(f"the first violation of {many}: {first.sentence}")
            parts += [f"the last: {last.sentence}"] if last.sentence != first.sentence else []
        return parts

    @property
    def kind(self) -> str:
        """Without what differs from scene to scene: equal failures are equal texts."""
        if self.refused is not None:
            return f"refused: {self.refused.kind}"
        if self.ended:
            return self.ended
        failed = ", ".join(each.name for each in self.unmet) or self._briefly
        clutter = dict.fromkeys(each.kind for each in self.clutter_contacts)
        happened = [each.kind for each in self.touches] + [*clutter]
        happened += [each.kind for each in (*self.lost, *self.rejections[:1])]
        return "; ".join([failed, *happened])

    @property
    def _briefly(self) -> str:
        """Why it failed though no condition did at the end."""
        if self.closest == NOTHING:
            return IDLE
        return TOUCHED if self.touches else TOO_SHORT
