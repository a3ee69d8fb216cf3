"""Monitors, asked at every control step: of a plan, by its checks and a watch of its own, and of a policy."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Unpack

import numpy as np

from rf_exp.constraints.check import Check, violation
from rf_exp.constraints.checks.avoidance import TRAILS_STEPS, AvoidAgentsCheck, touching
from rf_exp.constraints.plan import Plan
from rf_exp.findings import About, Cause, CheckName, Finding, Violation
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, Segment, arm_of, doing

TRACKING_RAD = 0.15  # beyond the lag
LOST_STEPS = 4  # control steps without grip before something counts as lost
_WATCHED: Mapping[Finding, tuple[CheckName, Cause, str]] = {  # who finds it, what it is about, the unit
    Finding.PUSHES: (CheckName.COLLISION, Cause.CONTACT, "N"),
    Finding.HIT: (CheckName.COLLISION, Cause.CONTACT, "N"),
    Finding.DROPPED: (CheckName.INTERACTION, Cause.GRIP, "s"),
    Finding.STRAYED: (CheckName.TRACKING, Cause.TRACKING, "rad"),
}


class Monitor:
    """Watches one execution of a plan."""

    def __init__(self, plan: Plan, checks: Sequence[Check]) -> None:
        self._plan, self._checks = plan, checks
        self._lost: dict[int, int] = {}  # agent -> control steps for which it has not held what it should

    def __call__(self, scene: Scene) -> Violation | None:
        """All checks on the real state at one control step."""
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
        return self._struck(scene) or self._dropped(scene) or self._strayed(scene)

    def _struck(self, scene: Scene) -> Violation | None:
        """Arms push each other, or one a thing that it is not about, so hard that a real one would stop."""
        plan = self._plan

        def now(agent: int) -> Segment | None:
            return plan.segment_at(agent, plan.position_now(agent, scene))

        reflex_n = {agent: arm.robot.reflex_n for agent, arm in plan.task.arms.items()}
        forces: list[tuple[float, tuple[int, ...], tuple[str, ...]]] = [
            (force_n, (a, b), ()) for a, b, force_n in scene.arm_contacts
        ]
        for (agent, name), force in scene.finger_forces.items():
            if (segment := now(agent)) is None or name not in segment.about:
                forces.append((float(np.linalg.norm(force)), (agent,), (name,)))
        numbers = {f"agent{agent}": agent for agent in plan.task.agents}
        forces += [(n, (numbers[who],), (name,)) for who, name, n in scene.clutter_contacts if who in numbers]
        hits = [each for each in forces if each[0] > min(reflex_n[agent] for agent in each[1])]
        if not hits:
            return None
        force_n, agents, things = max(hits)
        finding, bound_n = Finding.PUSHES if things else Finding.HIT, min(reflex_n[agent] for agent in agents)
        does = tuple(doing(now(agent)) for agent in agents)
        return _seen(scene, finding, force_n, bound_n, agents=agents, obstacles=things, doing=does)

    def _dropped(self, scene: Scene) -> Violation | None:
        """An agent no longer holds what it should carry."""
        plan = self._plan
        for trajectory in plan.trajectories:
            agent = trajectory.agent
            position = plan.position_now(agent, scene)
            segment = plan.segment_at(agent, position) if position > 0 else None
            carried = segment.attached if segment is not None else None
            holds = carried is None or scene.held[agent - 1] == carried
            self._lost[agent] = 0 if holds else self._lost.get(agent, 0) + 1
            if self._lost[agent] >= LOST_STEPS and segment is not None:
                numbers = self._lost[agent] * CONTROL_DT_S, LOST_STEPS * CONTROL_DT_S
                about: About = {"agents": (agent,), "object": carried, "doing": (doing(segment),)}
                return _seen(scene, Finding.DROPPED, *numbers, **about)
        return None

    def _strayed(self, scene: Scene) -> Violation | None:
        """A measured arm is not where any of its recent commands sent it."""
        plan = self._plan
        for trajectory in plan.trajectories:
            agent = trajectory.agent
            recent = plan.recent(agent, scene, TRAILS_STEPS)
            path = arm_of(trajectory.path())
            targets = path[recent.min() : recent.max() + 1]
            error = float(np.abs(targets - scene.qpos[agent - 1, : path.shape[1]]).max(axis=1).min())
            if error > TRACKING_RAD:
                does = plan.doing((agent,), recent[-1:])
                return _seen(scene, Finding.STRAYED, error, TRACKING_RAD, agents=(agent,), doing=does)
        return None


class PolicyMonitor:
    """Watches a policy act: arms that touch or overlap, nothing else. For counting, not for stopping.

    What a policy is about is unknown, so a gripper, or what it holds, may meet what another one holds.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs = tuple(combinations(task.agents, 2))
        self._may_touch = dict.fromkeys(task.agents, frozenset(task.objects))

    def __call__(self, scene: Scene) -> Violation | None:
        found = touching(self._task, scene, self._pairs, self._may_touch)
        if found is None:
            return None
        return violation(AvoidAgentsCheck(found.agents), found)


def _seen(scene: Scene, finding: Finding, value: float, bound: float, **about: Unpack[About]) -> Violation:
    """What the watch has found in a measured scene."""
    check, cause, unit = _WATCHED[finding]
    facts: About = {"measured": True, **about}
    return Violation(finding, value, bound, unit, check=check, cause=cause, time_s=scene.time_s, **facts)
