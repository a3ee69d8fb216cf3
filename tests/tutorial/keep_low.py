"""A kind of constraint of one's own: the gripper of an agent stays below a height."""

from dataclasses import dataclass
from typing import ClassVar

from rf_exp.constraints import Check, Evidence, Plan, check_of
from rf_exp.statements import Form, Statement, Words, agent_name
from rf_exp.types import CONTROL_DT_S, Kind, Scene


@dataclass(frozen=True)
class KeepLow(Statement):
    """The gripper of an agent stays below a height over the table."""

    kind: ClassVar[Kind] = "spatial"

    agent: int
    below_m: float

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must keep its gripper below {self.below_m} m."

    @classmethod
    def forms(cls) -> tuple[Form, ...]:
        return (Form(r"{agent} {must} keep (?:its|the) gripper below (?P<below>\d\.\d+) ?m", cls.read),)

    @classmethod
    def read(cls, words: Words) -> Statement:
        return cls(words.agent(), float(words["below"]))


KeepLow.samples = (KeepLow(1, 0.5),)


@dataclass(frozen=True)
class LowGripper:
    """The check of `KeepLow`. Value and bound in metres."""

    kind: ClassVar[Kind] = "spatial"
    name: ClassVar[str] = "ValidateSpatialOccupancy"
    unit: ClassVar[str] = "m"

    agent: int
    below_m: float
    text: str

    @property
    def agents(self) -> tuple[int, ...]:
        return (self.agent,)

    def planned(self, plan: Plan) -> Evidence:
        heights_m = plan.bodies.arms[self.agent - 1].tcp(plan.trajectory(self.agent).path())[:, 2, 3]
        return self._evidence(float(heights_m.max()), plan.time_s(self.agent, int(heights_m.argmax())))

    def measured(self, scene: Scene, plan: Plan) -> Evidence:
        tcp = plan.bodies.arms[self.agent - 1].tcp(scene.qpos[self.agent - 1])
        return self._evidence(float(tcp[2, 3]), scene.step * CONTROL_DT_S)

    def _evidence(self, height_m: float, time_s: float) -> Evidence:
        reason = f"the gripper of {agent_name(self.agent)} is {height_m:.2f} m up (allowed {self.below_m} m)"
        return Evidence(height_m < self.below_m, height_m, self.below_m, reason, time_s)


@check_of.register
def _(stated: KeepLow, plans: object) -> Check:
    return LowGripper(stated.agent, stated.below_m, stated.sentence)
