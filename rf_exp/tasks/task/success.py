"""Success evaluation of an episode, step by step, and the account of its failure."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot

from rf_exp.findings import NO_STEPS, Account, Closest, ClutterContact, Lost, Touch, Unmet
from rf_exp.tasks.task.task import Task
from rf_exp.types import CONTROL_DT_S, Condition, Measured, Scene, Verdict

OFF_TABLE_M = 0.05  # below the top of the table
DROP_M = 0.05  # fall after release that counts as dropped; an object set down sinks by millimetres


class SuccessEvaluator:
    """Success evaluator of one episode: strict conditions must all hold for `hold_steps` steps in a row."""

    def __init__(self, task: Task, start: Scene) -> None:
        self._task, self._start, self._steps_met = task, start, 0
        self._conditions, self._paper = task.module.conditions, getattr(task.module, "paper", None)
        self._arm_reaches_m = [(robot.x_m, robot.y_m, robot.model.reach_m) for robot in task.robots]
        self._hold_steps = int(task.success["hold_steps"])
        self._release_height_m: dict[str, float] = {}  # object -> its height when last held
        places = {name: start.poses[name][:2, 3].tolist() for name in task.objects}
        self._initially_reachable = frozenset(
            name for name, place in places.items() if self._in_reach(*place)
        )

    def __call__(self, scene: Scene) -> Verdict:
        scene = scene.with_true_joints  # without joint measurement errors
        conditions: Mapping[str, Condition] = self._conditions(scene, self._start, self._task)
        evidence = {name: bool(holds) for name, holds in conditions.items()}
        holds = all(evidence.values())
        self._steps_met = self._steps_met + 1 if holds else 0
        return Verdict(
            self._steps_met >= self._hold_steps,
            bool(self._paper(scene, self._start, self._task)) if self._paper else holds,
            evidence,
            {name: condition for name, condition in conditions.items() if isinstance(condition, Measured)},
            self._lost(scene),
        )

    def _lost(self, scene: Scene) -> dict[str, str]:
        """Object -> how it was lost: off the table, out of reach of every arm, or dropped."""
        lost = {}
        for name in self._task.objects:
            x_m, y_m, height_m = scene.poses[name][:3, 3].tolist()
            if name in scene.held:
                self._release_height_m[name] = height_m
            if height_m < -OFF_TABLE_M:
                lost[name] = "off the table"
            elif name in self._initially_reachable and not self._in_reach(x_m, y_m):
                lost[name] = "out of reach"
            elif self._release_height_m.get(name, height_m) - height_m > DROP_M:
                lost[name] = "dropped"
        return lost

    def _in_reach(self, x_m: float, y_m: float) -> bool:
        return any(
            [hypot(x_m - base_x, y_m - base_y) < reach for base_x, base_y, reach in self._arm_reaches_m]
        )


@dataclass
class _History:
    """Running record of one condition."""

    ever_met: bool = False  # at any step
    failing_since: int = 0  # step; valid while the condition does not hold
    measured: Measured | None = None  # at the last step
    best: float | None = None  # best value against the present bound


class Ledger:
    """Ledger of an episode: records every step and returns the account at the end."""

    def __init__(self) -> None:
        self._conditions: dict[str, _History] = {}
        self._streak = self._longest_streak = 0  # consecutive steps with all conditions met: now, at most
        self._verdict: Verdict | None = None
        self._best_count, self._best_step = -1, 0  # most conditions met at once, and the first such step
        self._touched: dict[tuple[int, int], list[int]] = {}  # agents -> steps
        self._clutter: dict[tuple[str, str], list[int]] = {}  # (agent or object, piece) -> steps
        self._lost: dict[tuple[str, str], int] = {}  # (object, how) -> first step
        self.contacts = 0  # control steps in which arms touched each other

    def record(self, scene: Scene, verdict: Verdict) -> None:
        """Records one control step: the scene after it and its verdict."""
        self._verdict = verdict
        for name, holds in verdict.evidence.items():
            self._record_condition(
                self._conditions.setdefault(name, _History()), holds, verdict.measured.get(name), scene
            )
        met = sum(verdict.evidence.values())
        self._streak = self._streak + 1 if met == len(verdict.evidence) else 0
        self._longest_streak = max(self._longest_streak, self._streak)
        if met > self._best_count:
            self._best_count, self._best_step = met, scene.step
        self.contacts += bool(scene.arm_contacts)
        for a, b, _ in scene.arm_contacts:
            self._touched.setdefault((a, b), []).append(scene.step)
        for toucher, name, _ in scene.clutter_contacts:
            self._clutter.setdefault((toucher, name), []).append(scene.step)
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
            return NO_STEPS
        at_s = _seconds(self._best_step) if self._best_count else 0.0
        return Closest(self._best_count, len(self._conditions), at_s, self._longest_streak)

    @staticmethod
    def _record_condition(history: _History, holds: bool, measured: Measured | None, scene: Scene) -> None:
        if holds:
            history.ever_met, history.failing_since = True, scene.step + 1
        previous, history.measured = history.measured, measured
        if measured is None:
            return
        better = max if measured.above else min
        same = previous is not None and (previous.bound, previous.unit) == (measured.bound, measured.unit)
        previous_best = history.best if same else None
        history.best = measured.value if previous_best is None else better(measured.value, previous_best)

    def account(self, success: bool) -> Account:
        """The account so far: only contacts for a success; `closest` alone before the first step."""
        touches = tuple(
            Touch(pair, _seconds(steps[0]), len(steps)) for pair, steps in sorted(self._touched.items())
        )
        clutter = tuple(
            ClutterContact(*pair, _seconds(steps[0]), len(steps))
            for pair, steps in sorted(self._clutter.items())
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
            lost=tuple(Lost(name, how, _seconds(first)) for (name, how), first in self._lost.items()),
        )


def _unmet(name: str, history: _History) -> Unmet:
    since_s = _seconds(history.failing_since) if history.ever_met else 0.0
    measured = history.measured
    if measured is None:
        return Unmet(name, since_s)
    return Unmet(name, since_s, measured.value, history.best, measured.bound, measured.unit, measured.above)


def _seconds(step: int) -> float:
    return step * CONTROL_DT_S
