"""The monitor of a plan: its checks on the real state, and a watch of its own, at every control step."""

from collections.abc import Sequence

import numpy as np

from rf_exp.constraints.checks import TRAILS_STEPS, AvoidAgentsCheck
from rf_exp.constraints.evidence import Check, Evidence, violation
from rf_exp.constraints.plan import Plan
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.types import CONTROL_DT_S, Scene, Segment, arm_of, doing

TRACKING_RAD = 0.15  # beyond the lag
LOST_STEPS = 4  # control steps without grip before something counts as lost


class Monitor:
    """Watches one execution of a plan."""

    def __init__(self, plan: Plan, checks: Sequence[Check]) -> None:
        self._plan, self._checks = plan, checks
        self._lost: dict[int, int] = {}  # agent -> control steps for which it has not held what it should

    def __call__(self, scene: Scene) -> Violation | None:
        """All checks on the real state at one control step."""
        plan = self._plan
        touched: dict[tuple[int, ...], Evidence | None] = {}
        for check in self._checks:
            if isinstance(check, AvoidAgentsCheck):  # one pair is often named by several constraints
                key = check.agents if len(check.agents) > 1 else plan.task.agents
                if key in touched:
                    continue
                check = AvoidAgentsCheck(key, check.text)
                evidence = touched[key] = check.measured(scene, plan)
            else:
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
        hits: list[tuple[float, tuple[int, ...], tuple[str, ...]]] = [
            (force_n, (a, b), ())
            for a, b, force_n in scene.arm_contacts
            if force_n > min(reflex_n[a], reflex_n[b])
        ]
        for (agent, name), force in scene.finger_forces.items():
            force_n = float(np.linalg.norm(force))
            if force_n > reflex_n[agent] and ((segment := now(agent)) is None or name not in segment.about):
                hits.append((force_n, (agent,), (name,)))
        if not hits:
            return None
        force_n, agents, things = max(hits)
        return Violation(
            check=CheckName.COLLISION,
            cause=Cause.CONTACT,
            finding=Finding.PUSHES if things else Finding.HIT,
            value=force_n,
            bound=min(reflex_n[agent] for agent in agents),
            unit="N",
            time_s=scene.step * CONTROL_DT_S,
            agents=agents,
            measured=True,
            obstacles=things,
            doing=tuple(doing(now(agent)) for agent in agents),
        )

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
                return Violation(
                    check=CheckName.INTERACTION,
                    cause=Cause.GRIP,
                    finding=Finding.DROPPED,
                    value=self._lost[agent] * CONTROL_DT_S,
                    bound=LOST_STEPS * CONTROL_DT_S,
                    unit="s",
                    time_s=scene.step * CONTROL_DT_S,
                    agents=(agent,),
                    measured=True,
                    object=carried,
                    doing=(doing(segment),),
                )
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
                return Violation(
                    check=CheckName.TRACKING,
                    cause=Cause.TRACKING,
                    finding=Finding.STRAYED,
                    value=error,
                    bound=TRACKING_RAD,
                    unit="rad",
                    time_s=scene.step * CONTROL_DT_S,
                    agents=(agent,),
                    measured=True,
                    doing=(doing(plan.segment_at(agent, int(recent[-1]))),),
                )
        return None
