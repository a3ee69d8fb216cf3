"""RoboChecker: from textual constraints to check code, schedules, verdicts and monitors.

Paper, section 3.1 and supplementary A. The check code is a typed composition of the four validation
functions; it holds when all of them hold. Kinds that a row of the ablation switches off are not checked.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations
from typing import Any, Unpack

import numpy as np

from rf_exp.constraints.check import CHECKS, Check, Evidence, PlanContext, violation
from rf_exp.constraints.checks.avoidance import (
    TRACKING_LAG_STEPS,
    AvoidAgentsCheck,
    AvoidObjectsCheck,
    contact_evidence,
)
from rf_exp.constraints.checks.before import BeforeCheck
from rf_exp.constraints.checks.speed_limit import SpeedLimitCheck
from rf_exp.constraints.checks.together import TogetherCheck
from rf_exp.constraints.plan import Paths, Plan
from rf_exp.coordination import Delays, Rule, schedule, sequential
from rf_exp.findings import Cause, CheckName, FactArguments, Finding, Violation
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M, Separation, Touches
from rf_exp.statements import Proposal, Statement
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, ConstraintSet, Scene, Schedule, Subgoal, Trajectory, arm_of

PlanPart = tuple[int, str | None, str | None]  # agent, verb, object; without a verb the agent's whole plan

TRACKING_RAD = 0.15  # joint error, lag excluded
LOST_STEPS = 4  # control steps without grip before an object counts as lost
_MONITOR_CHECKS: Mapping[Finding, tuple[CheckName, Cause, str]] = {  # check, cause, unit
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

    def enabled(self, constraint_set: ConstraintSet) -> tuple[Check, ...]:
        """The checks that a row of the ablation has switched on."""
        return tuple(check for check in self.checks if check.kind not in constraint_set.off)


def checked_kinds() -> Mapping[type[Statement], type[Check]]:
    return dict(CHECKS)


def compile_statement(statement: Statement, task: Task, proposal: Proposal) -> Check:
    """The check of a statement, compiled against the subgoals, objects and points of a plan.

    Raises ArgumentError where the statement does not fit the plan, TypeError for a kind that has no check.
    """
    validated, check_type = statement.checked_against(task.vocabulary), CHECKS.get(type(statement))
    if check_type is None:
        raise TypeError(f"no check has the statement_type {type(statement).__name__}")
    return check_type.from_statement(validated, PlanContext(task, proposal, statement))


def compile_constraints(constraints: Sequence[Statement], task: Task, proposal: Proposal) -> CheckCode:
    """The check code of constraints. Raises ArgumentError for one that is not understood or does not fit."""
    return CheckCode(tuple(compile_statement(statement, task, proposal) for statement in constraints))


class Monitor:
    """Monitor of one execution of a plan: returns the violation in a measured scene, if any."""

    def __init__(self, plan: Plan, checks: Sequence[Check]) -> None:
        self._plan, self._checks = plan, checks
        self._steps_without_grip: dict[
            int, int
        ] = {}  # agent -> control steps since it held what it should carry
        self._reflex_n = {agent: arm.robot.reflex_n for agent, arm in plan.task.arms.items()}

    def __call__(self, scene: Scene) -> Violation | None:
        plan = self._plan
        checked_agents: set[tuple[int, ...]] = set()
        for check in self._checks:
            if isinstance(check, AvoidAgentsCheck):  # one pair is often named by several constraints
                key = check.agents if len(check.agents) > 1 else plan.task.agents
                if key in checked_agents:
                    continue
                checked_agents.add(key)
                check = AvoidAgentsCheck(key, check.text)
            evidence = check.measured(scene, plan)
            if evidence is not None and not evidence.ok:
                return violation(check, evidence)
        positions = {agent: plan.position_now(agent, scene) for agent in plan.task.agents}
        return (
            self._collision(scene, positions)
            or self._lost_object(scene, positions)
            or self._tracking_error(scene)
        )

    def _collision(self, scene: Scene, positions: Mapping[int, int]) -> Violation | None:
        """Arms push each other, or an object outside their segment, so hard that a real arm would stop."""
        plan, reflex_n = self._plan, self._reflex_n
        forces: list[tuple[float, tuple[int, ...], tuple[str, ...]]] = [
            (force_n, (a, b), ()) for a, b, force_n in scene.arm_contacts
        ]
        for (agent, name), force in scene.finger_forces.items():
            segment = plan.trajectory(agent).segment_at(positions[agent])
            if segment is None or name not in segment.involved_names:
                forces.append((float(np.linalg.norm(force)), (agent,), (name,)))
        agent_of_name = {f"agent{agent}": agent for agent in plan.task.agents}
        forces += [
            (force_n, (agent_of_name[source],), (name,))
            for source, name, force_n in scene.clutter_contacts
            if source in agent_of_name
        ]
        collisions = [
            collision for collision in forces if collision[0] > min(reflex_n[agent] for agent in collision[1])
        ]
        if not collisions:
            return None
        force_n, agents, objects = max(collisions)
        finding, bound_n = (
            Finding.PUSHES if objects else Finding.HIT,
            min(reflex_n[agent] for agent in agents),
        )
        activities = plan.doing(agents, [positions[agent] for agent in agents])
        return _measured_violation(
            scene, finding, force_n, bound_n, agents=agents, obstacles=objects, doing=activities
        )

    def _lost_object(self, scene: Scene, positions: Mapping[int, int]) -> Violation | None:
        """An agent no longer holds the object that it should carry."""
        plan = self._plan
        for agent in plan.task.agents:
            position = positions[agent]
            segment = plan.trajectory(agent).segment_at(position) if position > 0 else None
            carried = segment.grasped_object if segment is not None else None
            has_grip = carried is None or scene.held[agent - 1] == carried
            self._steps_without_grip[agent] = 0 if has_grip else self._steps_without_grip.get(agent, 0) + 1
            if self._steps_without_grip[agent] >= LOST_STEPS and segment is not None:
                durations_s = self._steps_without_grip[agent] * CONTROL_DT_S, LOST_STEPS * CONTROL_DT_S
                activities = plan.doing((agent,), (position,))
                return _measured_violation(
                    scene, Finding.DROPPED, *durations_s, agents=(agent,), object=carried, doing=activities
                )
        return None

    def _tracking_error(self, scene: Scene) -> Violation | None:
        """A measured arm is far from all of its recent joint targets."""
        plan = self._plan
        for trajectory in plan.trajectories:
            agent = trajectory.agent
            recent = plan.recent_positions(agent, scene, TRACKING_LAG_STEPS)
            path = arm_of(trajectory.path())
            targets = path[recent[0] : recent[-1] + 1]  # agents only move forward on a path
            error = float(np.abs(targets - scene.qpos[agent - 1, : path.shape[1]]).max(axis=1).min())
            if error > TRACKING_RAD:
                activities = plan.doing((agent,), recent[-1:])
                return _measured_violation(
                    scene, Finding.STRAYED, error, TRACKING_RAD, agents=(agent,), doing=activities
                )
        return None


class PolicyMonitor:
    """Monitor of a policy: arms that touch or overlap, nothing else. For counting, not for stopping.

    It uses the true joint positions, without measurement errors.

    The subgoals of a policy are unknown, so a gripper, or what it holds, may touch what another one holds.
    """

    def __init__(self, task: Task) -> None:
        self._separation = Separation(task)
        self._pairs, objects = tuple(combinations(task.agents, 2)), frozenset(task.objects)
        self._may_touch: Touches = lambda agent: objects

    def __call__(self, scene: Scene) -> Violation | None:
        evidence = contact_evidence(self._separation, scene.with_true_joints, self._pairs, self._may_touch)
        if evidence is None:
            return None
        return violation(AvoidAgentsCheck(evidence.agents), evidence)


def _measured_violation(
    scene: Scene, finding: Finding, value: float, bound: float, **arguments: Unpack[FactArguments]
) -> Violation:
    check, cause, unit = _MONITOR_CHECKS[finding]
    facts: FactArguments = {"measured": True, **arguments}
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
        results = zip(self.checks, self.evidence, strict=True)
        failed = [violation(check, evidence) for check, evidence in results if not evidence.ok]
        return sorted(failed, key=lambda violation: violation.time_s)

    def monitor(self) -> Monitor:
        return Monitor(self.plan, self.checks)

    def certificate(self) -> dict[str, Any]:
        """The checks before execution with their results; plain JSON values."""
        schedule = self.plan.schedule
        return {
            "row": self.plan.paths.constraint_set.name,
            "margins_m": {"agents": AGENT_MARGIN_M, "objects": OBJECT_MARGIN_M},
            "makespan_s": len(schedule) * CONTROL_DT_S,
            "makespan_bound_s": schedule.makespan_bound * CONTROL_DT_S,
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
        self.code = compile_constraints(proposal.constraints, task, proposal)
        implied = _implied_checks(task, self.code.checks) if constraint_set.spatial else ()
        self.checks = *self.code.enabled(constraint_set), *implied

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
    def speed_limits_m_s(self) -> dict[int, float]:
        """Agent -> maximum speed of its gripper, for agents with a limit in this row."""
        limits_m_s: dict[int, float] = {}
        for check in self.checks:
            if isinstance(check, SpeedLimitCheck):
                limits_m_s[check.agent] = min(
                    check.at_most_m_s, limits_m_s.get(check.agent, check.at_most_m_s)
                )
        return limits_m_s

    @property
    def order(self) -> tuple[tuple[PlanPart, PlanPart], ...]:
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
        extra_rules: Sequence[Rule] = (),
    ) -> Schedule | Violation:
        """The shortest schedule where temporal constraints are on, otherwise one in which agents take turns.

        Turns follow the order of the proposal unless given. `extra_rules` come besides those of the code.
        """
        trajectories = paths.trajectories
        if not self._constraint_set.temporal:
            proposal = self._proposal if turns is None else replace(self._proposal, subgoals=tuple(turns))
            return sequential(trajectories, proposal)
        diagrams = paths.diagrams if self._constraint_set.spatial else {}
        rules = (*self.rules(paths), *extra_rules)
        return schedule(trajectories, diagrams, rules, delays, begins_s=paths.scene.time_s)

    def check(self, paths: Paths, schedule: Schedule) -> CheckedPlan:
        """All checks on a plan before execution."""
        plan = Plan(paths, schedule)
        return CheckedPlan(plan, self.checks, tuple(check.planned(plan) for check in self.checks))


def _implied_checks(task: Task, checks: Sequence[Check]) -> tuple[Check, ...]:
    """Clearance checks for pairs and agents that the code does not mention."""
    pairs = {pair for check in checks if isinstance(check, AvoidAgentsCheck) for pair in check.pairs(task)}
    watched = {agent for check in checks if isinstance(check, AvoidObjectsCheck) for agent in check.agents}
    unwatched = tuple(agent for agent in task.agents if agent not in watched)
    text = "implied: nothing was said about it"
    agents = (AvoidAgentsCheck(pair, text) for pair in combinations(task.agents, 2) if pair not in pairs)
    return (*agents, *((AvoidObjectsCheck(unwatched, text),) if unwatched else ()))
