from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, Plans
from rf_exp.constraints.phases import span
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, named
from rf_exp.findings import CheckName, Finding, names
from rf_exp.statements import SameHeight, Step
from rf_exp.tasks import Task
from rf_exp.types import Scene

HEIGHT_M = 0.02
HEIGHT_MEASURED_M = 0.03


@dataclass(frozen=True)
class SameHeightCheck(BoundedCheck):
    """Agents that carry one object together raise it by the same height. Value and bound in metres.

    Checked at every control step of the schedule where temporal constraints are on, otherwise at the end of
    the plan. With a `phase` (one per agent) only there.
    """

    states, name, unit = SameHeight, CheckName.DIRECTION, "m"
    finding, bounds = Finding.UNEVEN, (HEIGHT_M, HEIGHT_MEASURED_M)

    agents: tuple[int, ...]
    text: str = ""
    phase: tuple[Step, ...] = ()

    @classmethod
    def compiled(cls, stated: SameHeight, plans: Plans) -> "SameHeightCheck":
        phase = tuple(map(plans.step, stated.phase)) if stated.verb else ()
        return cls(stated.agents, stated.sentence, phase)

    def __repr__(self) -> str:
        when = f", {self.phase[0].verb}" if self.phase else ""
        return f"VD({names(self.agents)}, consistent height{when})"

    def planned(self, plan: Plan) -> Evidence:
        worst = self.idle(plan, HEIGHT_M)
        for name in self._together(plan):
            rises = np.stack([self._rise_m(plan, agent, name) for agent in self.agents])  # (agents, T + 1)
            spread = np.ptp(rises, axis=0)
            at = self.worst(spread)
            if spread[at] >= worst.value:
                worst = self.judged(spread[at], plan.step_s(at), object=name)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        held = {scene.held[agent - 1] for agent in self.agents}
        name = next(iter(held))
        if not plan.paths.constraint_set.temporal or len(held) != 1 or name not in self._together(plan):
            return None
        rises = []
        for agent in self.agents:
            begin, end = self._span(plan, agent, name)
            now = plan.position_now(agent, scene)
            if now <= begin or (self.phase and now > end):
                return None
            arm = plan.task.arms[agent]
            joints = map(arm.joints, (scene.qpos[agent - 1], plan.trajectory(agent).path()[begin]))
            here, before = arm.tcp(np.stack(list(joints)))
            rises.append(here[2, 3] - before[2, 3])
        return self.judged(np.ptp(rises), scene.time_s, measured=True, object=name)

    def _together(self, plan: Plan) -> list[str]:
        """The objects that all of its agents carry in this plan."""
        carried = ({each.attached for each in plan.trajectory(agent).segments} for agent in self.agents)
        return sorted(filter(None, set.intersection(*carried)))

    def _span(self, plan: Plan, agent: int, name: str) -> tuple[int, int]:
        """Path positions between which an agent carries an object and has to keep level with the others."""
        begin, end = _carried(plan, agent, name)
        for step in self.phase:
            if step.agent == agent and (part := span(step, plan.trajectory(agent))) is not None:
                return max(begin, part[0]), max(begin, min(end, part[1]))
        return begin, end

    def _rise_m(self, plan: Plan, agent: int, name: str) -> NDArray[np.float64]:
        """Rise of an object by an agent: (T + 1,), or (1,) at the end where temporal constraints are off."""
        height, timed = plan.paths.grippers_m(agent)[:, 2], plan.paths.constraint_set.temporal
        positions = plan.positions(agent) if timed else np.array([len(height) - 1])
        begin, end = self._span(plan, agent, name)
        return height[np.clip(positions, begin, end)] - height[begin]

    def stl(self, task: Task) -> Specification:
        about = *self.agents, *((self.phase[0].verb or "all",) if self.phase else ())
        how = "between the highest and the lowest rise of the measured grippers since each began to carry"
        when = "all of them hold one thing, and are where they have to keep level"
        return self.formula(named("spread", *about), how, (named("together", *about), when))


def _carried(plan: Plan, agent: int, name: str) -> tuple[int, int]:
    """Path positions between which an agent carries an object for the first time."""
    runs = groupby(plan.trajectory(agent).intervals, key=lambda part: part[0].attached == name)
    parts = next(list(run) for carries, run in runs if carries)
    return parts[0][1], parts[-1][2]
