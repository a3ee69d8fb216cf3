from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.check import BoundedCheck, Evidence, PlanContext
from rf_exp.constraints.phases import span
from rf_exp.constraints.plan import Plan
from rf_exp.constraints.stl import Specification, identifier
from rf_exp.findings import CheckName, Finding, agent_names
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

    statement_type, name, unit = SameHeight, CheckName.DIRECTION, "m"
    finding, bounds = Finding.UNEVEN, (HEIGHT_M, HEIGHT_MEASURED_M)

    agents: tuple[int, ...]
    text: str = ""
    phase: tuple[Step, ...] = ()

    @classmethod
    def from_statement(cls, statement: SameHeight, context: PlanContext) -> "SameHeightCheck":
        phase = tuple(map(context.step, statement.phase)) if statement.verb else ()
        return cls(statement.agents, statement.sentence, phase)

    def __repr__(self) -> str:
        when = f", {self.phase[0].verb}" if self.phase else ""
        return f"VD({agent_names(self.agents)}, consistent height{when})"

    def planned(self, plan: Plan) -> Evidence:
        worst = self.not_applicable(plan, HEIGHT_M)
        for name in self._shared_objects(plan):
            rises_m = np.stack([self._rises_m(plan, agent, name) for agent in self.agents])  # (agents, T + 1)
            spreads_m = np.ptp(rises_m, axis=0)
            step = self.worst(spreads_m)
            if spreads_m[step] >= worst.value:
                worst = self.evidence_for(spreads_m[step], plan.step_end_s(step), object=name)
        return worst

    def measured(self, scene: Scene, plan: Plan) -> Evidence | None:
        held = {scene.held[agent - 1] for agent in self.agents}
        name = next(iter(held))
        if not plan.paths.constraint_set.temporal or len(held) != 1 or name not in self._shared_objects(plan):
            return None
        rises_m = []
        for agent in self.agents:
            begin, end = self._carrying_span(plan, agent, name)
            position = plan.position_now(agent, scene)
            if position <= begin or (self.phase and position > end):
                return None
            arm = plan.task.arms[agent]
            joints = map(arm.joints, (scene.qpos[agent - 1], plan.trajectory(agent).path()[begin]))
            tcp, start_tcp = arm.tcp(np.stack(list(joints)))
            rises_m.append(tcp[2, 3] - start_tcp[2, 3])
        return self.evidence_for(np.ptp(rises_m), scene.time_s, measured=True, object=name)

    def _shared_objects(self, plan: Plan) -> list[str]:
        """The objects that all of its agents carry in this plan."""
        carried = ({segment.attached for segment in plan.trajectory(agent).segments} for agent in self.agents)
        return sorted(filter(None, set.intersection(*carried)))

    def _carrying_span(self, plan: Plan, agent: int, name: str) -> tuple[int, int]:
        """Path positions between which an agent carries an object and has to keep level with the others."""
        begin, end = _first_carrying_span(plan, agent, name)
        for step in self.phase:
            if step.agent == agent and (part := span(step, plan.trajectory(agent))) is not None:
                return max(begin, part[0]), max(begin, min(end, part[1]))
        return begin, end

    def _rises_m(self, plan: Plan, agent: int, name: str) -> NDArray[np.float64]:
        """Rise of an object by an agent: (T + 1,), or (1,) at the end where temporal constraints are off."""
        heights_m, is_scheduled = (
            plan.paths.gripper_positions_m(agent)[:, 2],
            plan.paths.constraint_set.temporal,
        )
        positions = plan.positions(agent) if is_scheduled else np.array([len(heights_m) - 1])
        begin, end = self._carrying_span(plan, agent, name)
        return heights_m[np.clip(positions, begin, end)] - heights_m[begin]

    def stl(self, task: Task) -> Specification:
        name_parts = *self.agents, *((self.phase[0].verb or "all",) if self.phase else ())
        description = (
            "between the highest and the lowest rise of the measured grippers since each began to carry"
        )
        condition = "all of them hold one thing, and are where they have to keep level"
        return self.formula(
            identifier("spread", *name_parts), description, (identifier("together", *name_parts), condition)
        )


def _first_carrying_span(plan: Plan, agent: int, name: str) -> tuple[int, int]:
    """Path positions between which an agent carries an object for the first time."""
    runs = groupby(plan.trajectory(agent).intervals, key=lambda interval: interval[0].attached == name)
    carrying = next(list(run) for carries, run in runs if carries)
    return carrying[0][1], carrying[-1][2]
