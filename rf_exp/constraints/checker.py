"""RoboChecker: from textual constraints to check code, schedules, verdicts and a monitor.

Paper, section 3.1 and supplementary A. The check code is a typed composition of the four validation
functions; it holds when all of them hold. What a row of the ablation switches off is not checked.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from rf_exp.constraints.check import Check, Evidence, compiled, violation
from rf_exp.constraints.checks.avoidance import AvoidAgentsCheck, AvoidObjectsCheck
from rf_exp.constraints.checks.before import BeforeCheck
from rf_exp.constraints.checks.speed_limit import SpeedLimitCheck
from rf_exp.constraints.checks.together import TogetherCheck
from rf_exp.constraints.monitor import Monitor
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.coordination import Delays, Rule, schedule, sequential
from rf_exp.findings import Violation
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M
from rf_exp.statements import Proposal, Statement
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, ConstraintSet, Scene, Schedule, Subgoal, Trajectory

Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all that the agent does


@dataclass(frozen=True)
class CheckCode:
    """A composition of validators; printed as in the paper's figure."""

    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        return " and ".join(map(repr, self.checks)) or "True"

    def of(self, constraint_set: ConstraintSet) -> tuple[Check, ...]:
        """The checks that a row of the ablation has switched on."""
        return tuple(check for check in self.checks if check.kind not in constraint_set.off)


def compile(constraints: Sequence[Statement], task: Task, proposal: Proposal) -> CheckCode:
    """The check code of constraints. Raises ArgumentError for one that is not understood or does not fit."""
    return CheckCode(tuple(compiled(stated, task, proposal) for stated in constraints))


@dataclass(frozen=True, eq=False)
class CheckedPlan:
    """A plan, the checks of its row, and what each found before anything moves."""

    plan: Plan
    checks: tuple[Check, ...]
    evidence: tuple[Evidence, ...]  # of each check

    @property
    def violations(self) -> list[Violation]:
        """Of the checks that failed, earliest first."""
        found = zip(self.checks, self.evidence, strict=True)
        failed = [violation(check, evidence) for check, evidence in found if not evidence.ok]
        return sorted(failed, key=lambda each: each.time_s)

    def monitor(self) -> Monitor:
        """Watches one execution of the plan."""
        return Monitor(self.plan, self.checks)

    def certificate(self) -> dict[str, Any]:
        """What was checked before execution and with what result; plain JSON values."""
        timed = self.plan.schedule
        return {
            "row": self.plan.constraint_set.name,
            "margins_m": {"agents": AGENT_MARGIN_M, "objects": OBJECT_MARGIN_M},
            "makespan_s": len(timed) * CONTROL_DT_S,
            "makespan_bound_s": timed.makespan_bound * CONTROL_DT_S,
            "checks": [
                {
                    "check": check.name,
                    "kind": check.kind,
                    "code": repr(check),
                    "text": check.text,
                    "ok": bool(evidence.ok),
                    "value": float(evidence.value) if np.isfinite(evidence.value) else None,
                    "bound": float(evidence.bound),
                    "time_s": float(evidence.time_s),
                    "reason": evidence.sentence,
                }
                for check, evidence in zip(self.checks, self.evidence, strict=True)
            ],
        }


class RoboChecker:
    """Compiles the constraints of a proposal; schedules and checks paths for it under a row of the ablation.

    It keeps nothing of what it has checked. Where spatial constraints are on and the code is silent about an
    agent, clearance is checked for it all the same. Raises ArgumentError for a constraint that is not
    understood or does not fit the proposal.
    """

    def __init__(self, task: Task, proposal: Proposal, constraint_set: ConstraintSet) -> None:
        self._task, self._constraint_set, self._proposal = task, constraint_set, proposal
        self.code = compile(proposal.constraints, task, proposal)
        implied = _implied(task, self.code.checks) if constraint_set.spatial else ()
        self.checks = *self.code.of(constraint_set), *implied

    def rules(self, paths: Paths) -> tuple[Rule, ...]:
        """What the active constraints demand of a schedule, those about time first."""
        in_order = sorted(self.checks, key=lambda check: check.kind != "temporal")
        return tuple(rule for check in in_order if (rule := check.rule(paths)) is not None)

    @property
    def lockstep(self) -> frozenset[tuple[frozenset[int], str, str]]:
        """(agents, verb, object) that must be one motion: simultaneous, and active in this row."""
        return frozenset(
            (frozenset(check.agents), check.steps[0].verb, check.steps[0].object)
            for check in self.checks
            if isinstance(check, TogetherCheck) and check.steps[0].verb and check.steps[0].object
        )

    @property
    def speeds_m_s(self) -> dict[int, float]:
        """Agent -> the speed that its gripper may have at most, where it has a limit in this row."""
        found: dict[int, float] = {}
        for check in self.checks:
            if isinstance(check, SpeedLimitCheck):
                found[check.agent] = min(check.at_most_m_s, found.get(check.agent, check.at_most_m_s))
        return found

    @property
    def order(self) -> tuple[tuple[Part, Part], ...]:
        """(first, then) of the sequences that are active in this row."""
        orders = [check.steps for check in self.checks if isinstance(check, BeforeCheck)]
        return tuple((astuple(first), astuple(then)) for first, then in orders)

    def paths(self, trajectories: Sequence[Trajectory], scene: Scene) -> Paths:
        """The trajectories of all agents from `scene` on, to be scheduled and checked."""
        return Paths(self._task, self._constraint_set, scene, tuple(trajectories))

    def schedule(
        self,
        paths: Paths,
        delays: Delays | None = None,
        *,
        turns: Sequence[Subgoal] | None = None,
        also: Sequence[Rule] = (),
    ) -> Schedule | Violation:
        """When everybody moves: the shortest schedule with a model of time, `turns` without one.

        Turns are taken in the order of the proposal unless given. `also` are rules beside those of the code.
        """
        trajectories = paths.trajectories
        if not self._constraint_set.temporal:
            in_turn = self._proposal if turns is None else replace(self._proposal, subgoals=tuple(turns))
            return sequential(trajectories, in_turn)
        diagrams = paths.diagrams if self._constraint_set.spatial else {}
        rules = (*self.rules(paths), *also)
        return schedule(trajectories, diagrams, rules, delays, begins_s=paths.begins_s)

    def check(self, paths: Paths, timed: Schedule) -> CheckedPlan:
        """All checks on a plan before anything moves."""
        plan = Plan(paths, timed)
        return CheckedPlan(plan, self.checks, tuple(check.planned(plan) for check in self.checks))


def _implied(task: Task, checks: Sequence[Check]) -> tuple[Check, ...]:
    """Clearance checks for what the code is silent about."""
    pairs = {pair for check in checks if isinstance(check, AvoidAgentsCheck) for pair in check.pairs(task)}
    watched = {agent for check in checks if isinstance(check, AvoidObjectsCheck) for agent in check.agents}
    silent = tuple(agent for agent in task.agents if agent not in watched)
    text = "implied: nothing was said about it"
    agents = (AvoidAgentsCheck(pair, text) for pair in combinations(task.agents, 2) if pair not in pairs)
    return (*agents, *((AvoidObjectsCheck(silent, text),) if silent else ()))
