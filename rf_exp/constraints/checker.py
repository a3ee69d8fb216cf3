"""RoboChecker: from textual constraints to check code, schedules, verdicts and monitors.

Paper, section 3.1 and supplementary A. The check code is a typed composition of the four validation
functions; it holds when all of them hold. Kinds that a row of the ablation switches off are not checked.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations
from typing import Any, Unpack

import numpy as np

from rf_exp.constraints.check import CHECKS, Check, Evidence, Plans, violation
from rf_exp.constraints.checks.avoidance import TRAILS_STEPS, AvoidAgentsCheck, AvoidObjectsCheck, touching
from rf_exp.constraints.checks.before import BeforeCheck
from rf_exp.constraints.checks.speed_limit import SpeedLimitCheck
from rf_exp.constraints.checks.together import TogetherCheck
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.coordination import Delays, Rule, schedule, sequential
from rf_exp.findings import About, Cause, CheckName, Finding, Violation
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M, Separation, Touches
from rf_exp.statements import Proposal, Statement
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, ConstraintSet, Scene, Schedule, Subgoal, Trajectory, arm_of

Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb the agent's whole plan

TRACKING_RAD = 0.15  # joint error, lag excluded
LOST_STEPS = 4  # control steps without grip before an object counts as lost
_WATCHED: Mapping[Finding, tuple[CheckName, Cause, str]] = {  # check, cause, unit
    Finding.PUSHES: (CheckName.COLLISION, Cause.CONTACT, "N"),
    Finding.HIT: (CheckName.COLLISION, Cause.CONTACT, "N"),
    Finding.DROPPED: (CheckName.INTERACTION, Cause.GRIP, "s"),
    Finding.STRAYED: (CheckName.TRACKING, Cause.TRACKING, "rad"),
}


@dataclass(frozen=True)
class CheckCode:
    """A composition of validators; printed as in the paper's figure."""

    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        return " and ".join(map(repr, self.checks)) or "True"

    def of(self, constraint_set: ConstraintSet) -> tuple[Check, ...]:
        """The checks that a row of the ablation has switched on."""
        return tuple(check for check in self.checks if check.kind not in constraint_set.off)


def checked_kinds() -> Mapping[type[Statement], type[Check]]:
    return dict(CHECKS)


def compiled(stated: Statement, task: Task, proposal: Proposal) -> Check:
    """The check of a statement, compiled against the subgoals, objects and points of a plan.

    Raises ArgumentError where the statement does not fit the plan, TypeError for a kind that has no check.
    """
    known, kind = stated.known_in(task.vocabulary), CHECKS.get(type(stated))
    if kind is None:
        raise TypeError(f"no check states that it is of {type(stated).__name__}")
    return kind.compiled(known, Plans(task, proposal, stated))


def compile(constraints: Sequence[Statement], task: Task, proposal: Proposal) -> CheckCode:
    """The check code of constraints. Raises ArgumentError for one that is not understood or does not fit."""
    return CheckCode(tuple(compiled(stated, task, proposal) for stated in constraints))


class Monitor:
    """Monitor of one execution of a plan: returns the violation in a measured scene, if any."""

    def __init__(self, plan: Plan, checks: Sequence[Check]) -> None:
        self._plan, self._checks = plan, checks
        self._lost: dict[int, int] = {}  # agent -> control steps since it held what it should carry
        self._reflex_n = {agent: arm.robot.reflex_n for agent, arm in plan.task.arms.items()}

    def __call__(self, scene: Scene) -> Violation | None:
        plan = self._plan
        touched: set[tuple[int, ...]] = set()
        for check in self._checks:
            if isinstance(check, AvoidAgentsCheck):  # one pair is often named by several constraints
                key = check.agents if len(check.agents) > 1 else plan.task.agents
                if key in touched:
                    continue
                touched.add(key)
                check = AvoidAgentsCheck(key, check.text)
            evidence = check.measured(scene, plan)
            if evidence is not None and not evidence.ok:
                return violation(check, evidence)
        now = {agent: plan.position_now(agent, scene) for agent in plan.task.agents}
        return self._struck(scene, now) or self._dropped(scene, now) or self._strayed(scene)

    def _struck(self, scene: Scene, now: Mapping[int, int]) -> Violation | None:
        """Arms push each other, or an object outside their segment, so hard that a real arm would stop."""
        plan, reflex_n = self._plan, self._reflex_n
        forces: list[tuple[float, tuple[int, ...], tuple[str, ...]]] = [
            (force_n, (a, b), ()) for a, b, force_n in scene.arm_contacts
        ]
        for (agent, name), force in scene.finger_forces.items():
            segment = plan.trajectory(agent).segment_at(now[agent])
            if segment is None or name not in segment.about:
                forces.append((float(np.linalg.norm(force)), (agent,), (name,)))
        numbers = {f"agent{agent}": agent for agent in plan.task.agents}
        forces += [(n, (numbers[who],), (name,)) for who, name, n in scene.clutter_contacts if who in numbers]
        hits = [each for each in forces if each[0] > min(reflex_n[agent] for agent in each[1])]
        if not hits:
            return None
        force_n, agents, things = max(hits)
        finding, bound_n = Finding.PUSHES if things else Finding.HIT, min(reflex_n[agent] for agent in agents)
        does = plan.doing(agents, [now[agent] for agent in agents])
        return _seen(scene, finding, force_n, bound_n, agents=agents, obstacles=things, doing=does)

    def _dropped(self, scene: Scene, now: Mapping[int, int]) -> Violation | None:
        """An agent no longer holds the object that it should carry."""
        plan = self._plan
        for agent in plan.task.agents:
            position = now[agent]
            segment = plan.trajectory(agent).segment_at(position) if position > 0 else None
            carried = segment.gripped if segment is not None else None
            holds = carried is None or scene.held[agent - 1] == carried
            self._lost[agent] = 0 if holds else self._lost.get(agent, 0) + 1
            if self._lost[agent] >= LOST_STEPS and segment is not None:
                numbers = self._lost[agent] * CONTROL_DT_S, LOST_STEPS * CONTROL_DT_S
                does = plan.doing((agent,), (position,))
                return _seen(scene, Finding.DROPPED, *numbers, agents=(agent,), object=carried, doing=does)
        return None

    def _strayed(self, scene: Scene) -> Violation | None:
        """A measured arm is far from all of its recent joint targets."""
        plan = self._plan
        for trajectory in plan.trajectories:
            agent = trajectory.agent
            recent = plan.recent(agent, scene, TRAILS_STEPS)
            path = arm_of(trajectory.path())
            targets = path[recent[0] : recent[-1] + 1]  # agents only move forward on a path
            error = float(np.abs(targets - scene.qpos[agent - 1, : path.shape[1]]).max(axis=1).min())
            if error > TRACKING_RAD:
                does = plan.doing((agent,), recent[-1:])
                return _seen(scene, Finding.STRAYED, error, TRACKING_RAD, agents=(agent,), doing=does)
        return None


class PolicyMonitor:
    """Monitor of a policy: arms that touch or overlap, nothing else. For counting, not for stopping.

    It uses the true joint positions, without measurement errors.

    The subgoals of a policy are unknown, so a gripper, or what it holds, may touch what another one holds.
    """

    def __init__(self, task: Task) -> None:
        self._separation = Separation(task)
        self._pairs, things = tuple(combinations(task.agents, 2)), frozenset(task.objects)
        self._may_touch: Touches = lambda agent: things

    def __call__(self, scene: Scene) -> Violation | None:
        found = touching(self._separation, scene.true, self._pairs, self._may_touch)
        if found is None:
            return None
        return violation(AvoidAgentsCheck(found.agents), found)


def _seen(scene: Scene, finding: Finding, value: float, bound: float, **about: Unpack[About]) -> Violation:
    check, cause, unit = _WATCHED[finding]
    facts: About = {"measured": True, **about}
    return Violation(finding, value, bound, unit, check=check, cause=cause, time_s=scene.time_s, **facts)


@dataclass(frozen=True, eq=False)
class CheckedPlan:
    """A plan, the checks of its row, and their evidence before execution."""

    plan: Plan
    checks: tuple[Check, ...]
    evidence: tuple[Evidence, ...]  # of each check

    @property
    def violations(self) -> list[Violation]:
        """The violations of failed checks, earliest first."""
        found = zip(self.checks, self.evidence, strict=True)
        failed = [violation(check, evidence) for check, evidence in found if not evidence.ok]
        return sorted(failed, key=lambda each: each.time_s)

    def monitor(self) -> Monitor:
        return Monitor(self.plan, self.checks)

    def certificate(self) -> dict[str, Any]:
        """The checks before execution with their results; plain JSON values."""
        timed = self.plan.schedule
        return {
            "row": self.plan.paths.constraint_set.name,
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

    It keeps no state between checks. Where spatial constraints are on, clearance is also checked for agents
    that the code does not mention. Raises ArgumentError for a constraint that is not understood or does not
    fit the proposal.
    """

    def __init__(self, task: Task, proposal: Proposal, constraint_set: ConstraintSet) -> None:
        self._task, self._constraint_set, self._proposal = task, constraint_set, proposal
        self.code = compile(proposal.constraints, task, proposal)
        implied = _implied(task, self.code.checks) if constraint_set.spatial else ()
        self.checks = *self.code.of(constraint_set), *implied

    def rules(self, paths: Paths) -> tuple[Rule, ...]:
        """The rules of the active constraints for a schedule, temporal ones first."""
        in_order = sorted(self.checks, key=lambda check: check.kind != "temporal")
        return tuple(rule for check in in_order if (rule := check.rule(paths)) is not None)

    @property
    def lockstep(self) -> frozenset[tuple[frozenset[int], str, str]]:
        """(agents, verb, object) of simultaneous subgoals active in this row, which must be one motion."""
        return frozenset(
            (frozenset(check.agents), check.steps[0].verb, check.steps[0].object)
            for check in self.checks
            if isinstance(check, TogetherCheck) and check.steps[0].verb and check.steps[0].object
        )

    @property
    def speeds_m_s(self) -> dict[int, float]:
        """Agent -> maximum speed of its gripper, for agents with a limit in this row."""
        found: dict[int, float] = {}
        for check in self.checks:
            if isinstance(check, SpeedLimitCheck):
                found[check.agent] = min(check.at_most_m_s, found.get(check.agent, check.at_most_m_s))
        return found

    @property
    def order(self) -> tuple[tuple[Part, Part], ...]:
        """(first, then) of the orders that are active in this row."""
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
        """The shortest schedule where temporal constraints are on, otherwise one in which agents take turns.

        Turns follow the order of the proposal unless given. `also` are rules besides those of the code.
        """
        trajectories = paths.trajectories
        if not self._constraint_set.temporal:
            in_turn = self._proposal if turns is None else replace(self._proposal, subgoals=tuple(turns))
            return sequential(trajectories, in_turn)
        diagrams = paths.diagrams if self._constraint_set.spatial else {}
        rules = (*self.rules(paths), *also)
        return schedule(trajectories, diagrams, rules, delays, begins_s=paths.scene.time_s)

    def check(self, paths: Paths, timed: Schedule) -> CheckedPlan:
        """All checks on a plan before execution."""
        plan = Plan(paths, timed)
        return CheckedPlan(plan, self.checks, tuple(check.planned(plan) for check in self.checks))


def _implied(task: Task, checks: Sequence[Check]) -> tuple[Check, ...]:
    """Clearance checks for pairs and agents that the code does not mention."""
    pairs = {pair for check in checks if isinstance(check, AvoidAgentsCheck) for pair in check.pairs(task)}
    watched = {agent for check in checks if isinstance(check, AvoidObjectsCheck) for agent in check.agents}
    silent = tuple(agent for agent in task.agents if agent not in watched)
    text = "implied: nothing was said about it"
    agents = (AvoidAgentsCheck(pair, text) for pair in combinations(task.agents, 2) if pair not in pairs)
    return (*agents, *((AvoidObjectsCheck(silent, text),) if silent else ()))
