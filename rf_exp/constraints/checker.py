"""RoboChecker: from textual constraints to check code, schedules, verdicts and a monitor.

Paper, section 3.1 and supplementary A. The check code is a typed composition of the four validation
functions; it holds when all of them hold. What a row of the ablation switches off is not checked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from rf_exp.constraints.compile import compiled
from rf_exp.constraints.evidence import Check, Evidence, Plan, doing, violation
from rf_exp.constraints.limits import Distance, Speed
from rf_exp.constraints.spatial import TRAILS_STEPS, AvoidAgents, AvoidObjects, StayOut
from rf_exp.constraints.temporal import Sequential, ShareSpace, Simultaneous
from rf_exp.constraints.timing import Delays, Rule, schedule, serial
from rf_exp.constraints.world import AGENT_MARGIN_M, OBJECT_MARGIN_M
from rf_exp.errors import ArgumentError
from rf_exp.statements import Proposal, Statement, agent_name
from rf_exp.tasks import Task
from rf_exp.types import (
    ARM_JOINTS,
    COLLISION,
    CONTROL_DT_S,
    Kind,
    Row,
    Scene,
    Schedule,
    Segment,
    Trajectory,
    Violation,
)

Part = tuple[int, str | None, str | None]  # agent, verb, object; without a verb all that the agent does

TRACKING_RAD = 0.15  # beyond the lag
REFLEX_N = 20.0  # on an arm; the collision reflex of a Panda is set to 20 N in its maker's examples
LOST_STEPS = 4  # control steps without grip before something counts as lost


@dataclass(frozen=True)
class CheckCode:
    """A composition of validators; printed as in the paper's figure."""

    checks: tuple[Check, ...]

    def __repr__(self) -> str:
        return " and ".join(map(repr, self.checks)) or "True"

    def of(self, row: Row) -> tuple[Check, ...]:
        """The checks that a row of the ablation has switched on."""
        active: dict[Kind, bool] = {"logical": row.logical, "spatial": row.spatial, "temporal": row.temporal}
        return tuple(check for check in self.checks if active[check.kind])


def compile(constraints: Sequence[Statement], task: Task, proposal: Proposal) -> CheckCode:
    """The check code of constraints. Raises ArgumentError for one that is not understood or does not fit."""
    return CheckCode(tuple(compiled(stated, task, proposal) for stated in constraints))


class Checker:
    """Schedules, checks and monitors one proposal under one row of the ablation.

    Where spatial constraints are on and the code is silent about an agent, clearance is checked for it
    all the same.
    """

    def __init__(self, task: Task, code: CheckCode, row: Row, proposal: Proposal | None = None) -> None:
        self._task, self._row, self._proposal = task, row, proposal
        self.checks = (*code.of(row), *(_implied(task, code) if row.spatial else ()))
        self.plan: Plan | None = None
        self.evidence: list[tuple[Check, Evidence]] = []
        self._lost: dict[int, int] = {}
        self._missing = 0

    @property
    def rules(self) -> tuple[Rule, ...]:
        """What the active temporal constraints demand of a schedule."""
        return tuple(check for check in self.checks if check.kind == "temporal")  # pyright: ignore[reportReturnType]

    @property
    def lockstep(self) -> frozenset[tuple[frozenset[int], str, str]]:
        """(agents, verb, object) that must be one motion: simultaneous, and active in this row."""
        return frozenset(
            (frozenset(check.agents), check.steps[0].verb, check.steps[0].object)
            for check in self.checks
            if isinstance(check, Simultaneous) and check.steps[0].verb and check.steps[0].object
        )

    @property
    def speeds_m_s(self) -> dict[int, float]:
        """Agent -> the speed that its gripper may have at most, where it has a limit in this row."""
        found: dict[int, float] = {}
        for check in self.checks:
            if isinstance(check, Speed):
                found[check.agent] = min(check.at_most_m_s, found.get(check.agent, check.at_most_m_s))
        return found

    @property
    def order(self) -> tuple[tuple[Part, Part], ...]:
        """(first, then) of the sequences that are active in this row."""
        return tuple(
            (
                (check.first.agent, check.first.verb, check.first.object),
                (check.then.agent, check.then.verb, check.then.object),
            )
            for check in self.checks
            if isinstance(check, Sequential)
        )

    @property
    def makes_room(self) -> frozenset[int]:
        """Agents that draw back once they are done: where space counts, or is shared in turns."""
        if self._row.spatial:
            return frozenset(self._task.agents)
        shared = (check.agents for check in self.checks if isinstance(check, ShareSpace))
        return frozenset(agent for agents in shared for agent in agents)

    def schedule(
        self, trajectories: Sequence[Trajectory], scene: Scene, delays: Delays | None = None
    ) -> Schedule | Violation:
        """When everybody moves: the shortest schedule with a model of time, turns without one."""
        plan = self._prepare(trajectories, scene)
        if not self._row.temporal:
            order = self._proposal or Proposal(tuple(s.subgoal for t in trajectories for s in t.segments), ())
            return serial(trajectories, order)
        zones = [check.closing(plan) for check in self.checks if isinstance(check, StayOut | Distance)]
        rules = (*self.rules, *(closing for closing in zones if closing is not None))
        timed = schedule(trajectories, plan.diagrams if self._row.spatial else {}, rules, delays)
        return replace(timed, time_s=plan.begins_s + timed.time_s) if isinstance(timed, Violation) else timed

    def check(self, trajectories: Sequence[Trajectory], timed: Schedule, scene: Scene) -> list[Violation]:
        """All checks on a plan before anything moves: the violations, earliest first."""
        prepared = self._prepare(trajectories, scene)
        self.plan = plan = _with_schedule(prepared, timed)
        self._lost, self._missing = {}, 0
        self.evidence = [(check, check.planned(plan)) for check in self.checks]
        failed = [violation(check, evidence) for check, evidence in self.evidence if not evidence.ok]
        return sorted(failed, key=lambda each: each.time_s)

    def monitor(self, scene: Scene) -> Violation | None:
        """All checks on the real state at one control step of the plan checked last."""
        plan = self.plan
        if plan is None:
            raise ArgumentError("there is nothing to monitor yet; call check() with a plan first")
        touched: dict[tuple[int, ...], Evidence | None] = {}
        for check in self.checks:
            if isinstance(check, AvoidAgents):  # one pair is often named by several constraints
                key = check.agents if len(check.agents) > 1 else self._task.agents
                if key in touched:
                    continue
                check = AvoidAgents(key, check.text)
                evidence = touched[key] = check.measured(scene, plan)
            else:
                evidence = check.measured(scene, plan)
            if evidence is not None and not evidence.ok:
                return violation(check, evidence)
        return self._struck(plan, scene) or self._dropped(plan, scene) or self._strayed(plan, scene)

    def certificate(self) -> dict[str, Any]:
        """What was checked before execution and with what result; plain JSON values."""
        plan = self.plan
        timed = plan.schedule if plan else None
        return {
            "row": self._row.name,
            "margins_m": {"agents": AGENT_MARGIN_M, "objects": OBJECT_MARGIN_M},
            "makespan_s": len(timed) * CONTROL_DT_S if timed else None,
            "makespan_bound_s": timed.makespan_bound * CONTROL_DT_S if timed else None,
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
                    "reason": evidence.reason,
                }
                for check, evidence in self.evidence
            ],
        }

    # the monitor's own watch

    def _prepare(self, trajectories: Sequence[Trajectory], scene: Scene) -> Plan:
        """The plan without a schedule; the same one for the same trajectories, with its diagrams."""
        plan, given = self.plan, tuple(trajectories)
        if (
            plan is not None
            and plan.scene is scene
            and tuple(map(id, plan.trajectories)) == tuple(map(id, given))
        ):
            return plan
        self.plan = Plan(self._task, self._row, scene, given)
        return self.plan

    def _struck(self, plan: Plan, scene: Scene) -> Violation | None:
        """Arms push each other, or one a thing that it is not about, so hard that a real one would stop."""

        def now(agent: int) -> Segment | None:
            return plan.segment_at(agent, plan.position_now(agent, scene))

        hits: list[tuple[float, tuple[int, ...], str]] = [
            (force_n, (a, b), "hit each other") for a, b, force_n in scene.arm_contacts if force_n > REFLEX_N
        ]
        for (agent, name), force in scene.finger_forces.items():
            force_n = float(np.linalg.norm(force))
            if force_n > REFLEX_N and ((segment := now(agent)) is None or name not in segment.about):
                hits.append((force_n, (agent,), f"pushes {name}"))
        if not hits:
            return None
        force_n, agents, what = max(hits)
        doings = ", and ".join(f"{agent_name(agent)}, {doing(now(agent))}" for agent in agents)
        reason = f"{doings}, {what} with {force_n:.0f} N (arms stop at {REFLEX_N:.0f} N)"
        return Violation(COLLISION, "contact", agents, scene.step * CONTROL_DT_S, force_n, REFLEX_N, reason)

    def _dropped(self, plan: Plan, scene: Scene) -> Violation | None:
        """An agent no longer holds what it should carry."""
        for trajectory in plan.trajectories:
            agent = trajectory.agent
            position = plan.position_now(agent, scene)
            segment = plan.segment_at(agent, position) if position > 0 else None
            carried = segment.carries if segment is not None else None
            holds = carried is None or scene.held[agent - 1] == carried
            self._lost[agent] = 0 if holds else self._lost.get(agent, 0) + 1
            if self._lost[agent] >= LOST_STEPS and segment is not None:
                reason = f"{agent_name(agent)}, {doing(segment)}, no longer holds {carried}"
                value = self._lost[agent] * CONTROL_DT_S
                bound = LOST_STEPS * CONTROL_DT_S
                return Violation(
                    "ValidateInteraction", "grip", (agent,), scene.step * CONTROL_DT_S, value, bound, reason
                )
        return None

    def _strayed(self, plan: Plan, scene: Scene) -> Violation | None:
        """A measured arm is not where any of its recent commands sent it."""
        now = scene.step - plan.scene.step
        for trajectory in plan.trajectories:
            agent, positions = trajectory.agent, plan.positions(trajectory.agent)
            recent = positions[np.clip(np.arange(now - TRAILS_STEPS, now + 1), 0, len(positions) - 1)]
            path = trajectory.path()[:, :ARM_JOINTS]
            targets = path[recent.min() : recent.max() + 1]
            error = float(np.abs(targets - scene.qpos[agent - 1, :ARM_JOINTS]).max(axis=1).min())
            if error > TRACKING_RAD:
                segment = plan.segment_at(agent, int(recent[-1]))
                reason = (
                    f"{agent_name(agent)}, {doing(segment)}, is {error:.2f} rad off its path "
                    f"(allowed {TRACKING_RAD} rad): something is in its way"
                )
                now_s = scene.step * CONTROL_DT_S
                return Violation("Tracking", "tracking", (agent,), now_s, error, TRACKING_RAD, reason)
        return None


class RoboChecker(Checker):
    """The checker of a proposal, compiled from its own constraints.

    `code` is the check code, or the Violation that says which constraint was not understood; then
    nothing is checked but what the row implies. `begins_s` is when it is asked, on the clock of the episode.
    """

    def __init__(self, task: Task, proposal: Proposal, row: Row, begins_s: float = 0.0) -> None:
        self.code: CheckCode | Violation
        try:
            self.code = code = compile(proposal.constraints, task, proposal)
        except ArgumentError as error:
            self.code = Violation("CheckCode", "answer", (), begins_s, 0.0, 0.0, str(error))
            code = CheckCode(())
        super().__init__(task, code, row, proposal)


def _with_schedule(plan: Plan, timed: Schedule) -> Plan:
    """The plan with its schedule; what has been computed about the paths is kept."""
    scheduled = Plan(plan.task, plan.row, plan.scene, plan.trajectories, timed)
    for name in ("bodies", "swept", "diagrams", "still", "blocked"):
        if name in plan.__dict__:
            scheduled.__dict__[name] = plan.__dict__[name]
    return scheduled


def _implied(task: Task, code: CheckCode) -> tuple[Check, ...]:
    """Clearance checks for what the code is silent about."""
    pairs = {pair for check in code.checks if isinstance(check, AvoidAgents) for pair in check.pairs(task)}
    missing = [pair for pair in combinations(task.agents, 2) if pair not in pairs]
    watched = {agent for check in code.checks if isinstance(check, AvoidObjects) for agent in check.agents}
    silent = tuple(agent for agent in task.agents if agent not in watched)
    text = "implied: nothing was said about it"
    agents: list[Check] = [AvoidAgents(pair, text) for pair in missing]
    return (*agents, *((AvoidObjects(silent, text),) if silent else ()))
