"""Two grippers, or two arms, keep a distance."""

from dataclasses import dataclass

import numpy as np

from rf_exp.constraints.compiler import Plans
from rf_exp.constraints.evidence import About, Check, Evidence
from rf_exp.constraints.plan import MEASURED_M, Paths, Plan
from rf_exp.constraints.stl import Specification, bounded, named
from rf_exp.coordination import Closing
from rf_exp.findings import CheckName, Doing, Finding, agent_name, names
from rf_exp.geometry import Mask, PlanningScene, Swept, closer_than, nearest
from rf_exp.statements import KeepApart
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S, Scene, doing


@dataclass(frozen=True)
class KeepApartCheck(Check):
    """Two grippers, or two arms, keep a distance. Value and bound in metres."""

    states, name, unit = KeepApart, CheckName.OCCUPANCY, "m"

    agents: tuple[int, int]
    at_least_m: float
    parts: str  # grippers | arms
    text: str = ""

    @classmethod
    def compiled(cls, stated: KeepApart, plans: Plans) -> "KeepApartCheck":
        return cls(stated.who, stated.at_least_m, stated.parts, stated.sentence)

    def __repr__(self) -> str:
        return f"VSO({names(self.agents)}, {self.parts} {self.at_least_m:g} m apart)"

    def rule(self, paths: Paths) -> Closing:
        return Closing(self.agents, self._close(paths))

    def _close(self, paths: Paths) -> Mask:
        """(P_i, P_j) the pairs of path positions at which they are too close."""
        if self.parts == "arms":
            a, b = (_links(paths.swept[agent - 1]) for agent in self.agents)
            return closer_than(a, b, self.at_least_m)
        a_m, b_m = (paths.grippers_m(agent) for agent in self.agents)
        return np.linalg.norm(a_m[:, None] - b_m[None], axis=-1) < self.at_least_m

    def planned(self, plan: Plan) -> Evidence:
        at = np.stack([plan.positions(agent) for agent in self.agents], axis=1)
        if self.parts == "arms":
            a, b = (_links(plan.paths.swept[agent - 1]) for agent in self.agents)
            gap = nearest(a, b, at)
            assert gap is not None  # links must always keep apart
            value, step = gap.distance_m, int(np.flatnonzero((at == gap.at).all(axis=1))[0])
        else:
            a_m, b_m = (plan.paths.grippers_m(agent)[at[:, row]] for row, agent in enumerate(self.agents))
            apart_m = np.linalg.norm(a_m - b_m, axis=1)
            step = int(apart_m.argmin())
            value = float(apart_m[step])
        time_s = plan.begins_s + step * CONTROL_DT_S
        does = tuple(
            doing(plan.segment_at(agent, int(position)))
            for agent, position in zip(self.agents, at[step], strict=True)
        )
        return self._near(value, self.at_least_m, time_s, does)

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        planning_scene = PlanningScene(plan.task, scene)
        if self.parts == "arms":
            value = planning_scene.between(*self.agents).distance_m
        else:
            a, b = (planning_scene.arms[agent - 1].tcp(scene.qpos[agent - 1])[:3, 3] for agent in self.agents)
            value = float(np.linalg.norm(a - b))
        return self._near(value, self._measured_m, scene.step * CONTROL_DT_S, None)

    @property
    def _measured_m(self) -> float:
        """The bound of measured arms."""
        return max(0.0, self.at_least_m - MEASURED_M)

    def _near(
        self, value: float, bound_m: float, time_s: float, does: tuple[Doing | None, ...] | None
    ) -> Evidence:
        """`does`: what each agent is about, as planned; None as measured."""
        about: About = {"measured": does is None, "aspect": self.parts, "doing": does or ()}
        return self.found(value >= bound_m, Finding.TOO_NEAR, value, bound_m, time_s, **about)

    def stl(self, task: Task) -> Specification:
        how = f"between the measured {self.parts} of {' and '.join(map(agent_name, self.agents))}"
        return bounded(self, (named("distance", self.parts, *self.agents), how), ">=", self._measured_m)


def _links(body: Swept) -> Swept:
    """An arm without what it carries, at its path positions; nothing of it may touch anything."""
    columns = [column for column, label in enumerate(body.labels) if label not in body.objects]
    return Swept(
        tuple(body.pieces[column] for column in columns),
        tuple(body.labels[column] for column in columns),
        body.poses[:, columns],
    )
