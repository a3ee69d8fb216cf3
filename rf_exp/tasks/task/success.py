"""Success evaluation of an episode, step by step, and the account of its failure."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot

from rf_exp.findings import NOTHING, Account, Closest, ClutterContact, Lost, Touch, Unmet
from rf_exp.tasks.task.task import Task
from rf_exp.types import CONTROL_DT_S, Condition, Measured, Scene, Verdict

OFF_M = 0.05  # below the top of the table
DROP_M = 0.05  # fall after release that counts as dropped; an object set down sinks by millimetres


class SuccessEvaluator:
    """Success evaluator of one episode: strict conditions must all hold for `hold_steps` steps in a row."""

    def __init__(self, task: Task, start: Scene) -> None:
        self._task, self._start, self._steps = task, start, 0
        self._conditions, self._paper = task.module.conditions, getattr(task.module, "paper", None)
        self._reaches_m = [(robot.x_m, robot.y_m, robot.model.reach_m) for robot in task.robots]
        self._hold_steps = int(task.success["hold_steps"])
        self._let_go_m: dict[str, float] = {}  # object -> its height when last held
        places = {name: start.poses[name][:2, 3].tolist() for name in task.objects}
        self._reached = frozenset(name for name, place in places.items() if self._in_reach(*place))

    def __call__(self, scene: Scene) -> Verdict:
        scene = scene.true  # without joint measurement errors
        conditions: Mapping[str, Condition] = self._conditions(scene, self._start, self._task)
        evidence = {name: bool(holds) for name, holds in conditions.items()}
        holds = all(evidence.values())
        self._steps = self._steps + 1 if holds else 0
        return Verdict(
            self._steps >= self._hold_steps,
            bool(self._paper(scene, self._start, self._task)) if self._paper else holds,
            evidence,
            {name: found for name, found in conditions.items() if isinstance(found, Measured)},
            self._lost(scene),
        )

    def _lost(self, scene: Scene) -> dict[str, str]:
        """Object -> how it was lost: off the table, out of reach of every arm, or dropped."""
        lost = {}
        for name in self._task.objects:
            x_m, y_m, height_m = scene.poses[name][:3, 3].tolist()
            if name in scene.held:
                self._let_go_m[name] = height_m
            if height_m < -OFF_M:
                lost[name] = "off the table"
            elif name in self._reached and not self._in_reach(x_m, y_m):
                lost[name] = "out of reach"
            elif self._let_go_m.get(name, height_m) - height_m > DROP_M:
                lost[name] = "dropped"
        return lost

    def _in_reach(self, x_m: float, y_m: float) -> bool:
        return any([hypot(x_m - base_x, y_m - base_y) < reach for base_x, base_y, reach in self._reaches_m])


@dataclass
class _History:
    """Running record of one condition."""

    held: bool = False  # at any step
    failing_since: int = 0  # step; valid while the condition does not hold
    measured: Measured | None = None  # at the last step
    best: float | None = None  # best value against the present bound


class Ledger:
    """Ledger of an episode: records every step and returns the account at the end."""

    def __init__(self) -> None:
        self._conditions: dict[str, _History] = {}
        self._holding = self._longest = 0  # consecutive steps with all conditions met: now, at most
        self._verdict: Verdict | None = None
        self._most, self._most_at = -1, 0  # most conditions met at once, and the first such step
        self._touched: dict[tuple[int, int], list[int]] = {}  # agents -> steps
        self._clutter: dict[tuple[str, str], list[int]] = {}  # (agent or object, piece) -> steps
        self._lost: dict[tuple[str, str], int] = {}  # (object, how) -> first step
        self.contacts = 0  # control steps in which arms touched each other

    def see(self, scene: Scene, verdict: Verdict) -> None:
        """Records one control step: the scene after it and its verdict."""
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
            self._touched.setdefault((a, b), []).append(scene.step)
        for who, name, _ in scene.clutter_contacts:
            self._clutter.setdefault((who, name), []).append(scene.step)
        for lost in verdict.lost.items():
            self._lost.setdefault(lost, scene.step)

    @property
    def success(self) -> bool:
        """Whether the episode has succeeded without contact between arms: strict success of a policy."""
        return self._verdict is not None and self._verdict.success and not self.contacts

    @property
    def score(self) -> float:
        """Progress from 0 (before the first step) to 1 (success)."""
        return 1.0 if self.success else self._closest.score

    @property
    def _closest(self) -> Closest:
        if self._verdict is None:
            return NOTHING
        at_s = _s(self._most_at) if self._most else 0.0
        return Closest(self._most, len(self._conditions), at_s, self._longest)

    @staticmethod
    def _see(history: _History, holds: bool, measured: Measured | None, scene: Scene) -> None:
        if holds:
            history.held, history.failing_since = True, scene.step + 1
        before, history.measured = history.measured, measured
        if measured is None:
            return
        better = max if measured.above else min
        same = before is not None and (before.bound, before.unit) == (measured.bound, measured.unit)
        kept = history.best if same else None
        history.best = measured.value if kept is None else better(measured.value, kept)

    def account(self, success: bool) -> Account:
        """The account so far: only contacts for a success; `closest` alone before the first step."""
        touches = tuple(Touch(pair, _s(at[0]), len(at)) for pair, at in sorted(self._touched.items()))
        clutter = tuple(
            ClutterContact(*pair, _s(at[0]), len(at)) for pair, at in sorted(self._clutter.items())
        )
        if self._verdict is None:
            return Account(closest=self._closest)
        if success:
            return Account(touches=touches, clutter_contacts=clutter)
        failing = [name for name, holds in self._verdict.evidence.items() if not holds]
        return Account(
            touches=touches,
            clutter_contacts=clutter,
            unmet=tuple(_unmet(name, self._conditions[name]) for name in failing),
            closest=self._closest,
            lost=tuple(Lost(name, how, _s(first)) for (name, how), first in self._lost.items()),
        )


def _unmet(name: str, history: _History) -> Unmet:
    since_s = _s(history.failing_since) if history.held else 0.0
    found = history.measured
    if found is None:
        return Unmet(name, since_s)
    return Unmet(name, since_s, found.value, history.best, found.bound, found.unit, found.above)


def _s(step: int) -> float:
    return step * CONTROL_DT_S
