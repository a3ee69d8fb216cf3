"""Why a rollout failed, in one line: conditions, arms that touched, things that were lost.

    failed: held by both arms (since 4.10 s), lifted (never: 0.02 m, best 0.11, asked > 0.15);
    at best 3 of 4 (3.95 s); agents 1 and 2 touched (2.30 s, 14 steps); barrier dropped (4.10 s)

All that differs from scene to scene stands in parentheses: without them and without "at best", equal
failures are equal texts.
"""

from dataclasses import dataclass

from rf_exp.types import CONTROL_DT_S, Measured, Scene, Verdict


@dataclass
class _History:
    """One condition so far."""

    held: bool = False  # at any step
    failing_since: int = 0  # step, while it does not hold
    measured: Measured | None = None  # now
    best: float | None = None  # of the values against the bound it has now


class Account:
    """Sees every step of a rollout and says at the end why it was no success."""

    def __init__(self) -> None:
        self._conditions: dict[str, _History] = {}
        self._holding = self._longest = 0  # steps for which all conditions have held now, and ever
        self._verdict: Verdict | None = None
        self._most, self._most_at = -1, 0  # conditions that ever held at once, first at which step
        self._touched: dict[tuple[int, int], tuple[int, int]] = {}  # agents -> first step, number of steps
        self._lost: dict[tuple[str, str], int] = {}  # object, how -> first step
        self.contacts = 0  # control steps in which arms touched each other

    def see(self, scene: Scene, verdict: Verdict) -> None:
        """One control step: the scene after it and what the judge says of it."""
        self._verdict = verdict
        for name, holds in verdict.evidence.items():
            self._see(self._conditions.setdefault(name, _History()), holds, verdict.measured.get(name), scene)
        holding = sum(verdict.evidence.values())
        self._holding = self._holding + 1 if holding == len(verdict.evidence) else 0
        self._longest = max(self._longest, self._holding)
        if holding > self._most:
            self._most, self._most_at = holding, scene.step
        self.contacts += bool(scene.arm_contacts)
        for a, b, _ in scene.arm_contacts:
            first, steps = self._touched.get((a, b), (scene.step, 0))
            self._touched[a, b] = first, steps + 1
        for lost in verdict.lost.items():
            self._lost.setdefault(lost, scene.step)

    @staticmethod
    def _see(history: _History, holds: bool, measured: Measured | None, scene: Scene) -> None:
        if holds:
            history.held, history.failing_since = True, scene.step + 1
        before, history.measured = history.measured, measured
        if measured is None:
            return
        better = max if measured.above else min
        same = before is not None and (before.bound, before.unit) == (measured.bound, measured.unit)
        history.best = (
            better(measured.value, history.best) if same and history.best is not None else measured.value
        )

    def reason(self) -> str:
        """The line, for a rollout that has ended without success."""
        if self._verdict is None or not self._verdict.evidence:
            return "failed: success was not held long enough"
        failing = {
            name: self._conditions[name] for name, holds in self._verdict.evidence.items() if not holds
        }
        if failing:
            lines = ["failed: " + ", ".join(f"{name} ({_told(each)})" for name, each in failing.items())]
            lines += [f"at best {self._most} of {len(self._conditions)}{self._when_best()}"]
        else:
            lines = [f"failed: all conditions held, but not for long ({self._holding} steps at the end)"]
        lines += [
            f"agents {a} and {b} touched ({_s(first)}, {steps} steps)"
            for (a, b), (first, steps) in sorted(self._touched.items())
        ]
        lines += [f"{name} {how} ({_s(first)})" for (name, how), first in self._lost.items()]
        return "; ".join(lines)

    def _when_best(self) -> str:
        if not self._most:
            return ""
        long = f", for {self._longest} steps" if self._longest else ""
        return f" ({_s(self._most_at)}{long})"


def _told(condition: _History) -> str:
    """Since when a condition does not hold, and its value at the end and at best."""
    parts = [f"since {_s(condition.failing_since)}" if condition.held else "never"]
    if (found := condition.measured) is not None and condition.best is not None:
        better = not condition.held and f"{condition.best:.2g}" != f"{found.value:.2g}"
        best = f", best {condition.best:.2g}" if better else ""
        parts += [f"{found.value:.2g} {found.unit}{best}, asked {found.asked}"]
    return ": ".join(parts)


def _s(step: int) -> str:
    return f"{step * CONTROL_DT_S:.2f} s"
