"""Whether a disturbed arm has knocked something: a thing moves that nobody is moving."""

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Plan
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.types import CONTROL_DT_S, Scene

KNOCKED_M = 0.005


class Knocks:
    """Watches the things of a plan that are not being handled: they stay where they are."""

    def __init__(self, plan: Plan) -> None:
        """`plan` is what is executed."""
        self._plan = plan
        self._rest: dict[str, NDArray[np.float64]] = {n: pose[:3, 3] for n, pose in plan.scene.poses.items()}

    def knocked(self, scene: Scene) -> Violation | None:
        """What has been knocked by now."""
        handled = self._handled(scene)
        for name, pose in scene.poses.items():
            here = pose[:3, 3]
            if name in handled:
                self._rest[name] = here
            elif (moved_m := float(np.linalg.norm(here - self._rest[name]))) > KNOCKED_M:
                return Violation(
                    check=CheckName.KNOCKS,
                    cause=Cause.CONTACT,
                    finding=Finding.KNOCKED,
                    value=moved_m,
                    bound=KNOCKED_M,
                    unit="m",
                    time_s=scene.step * CONTROL_DT_S,
                    measured=True,
                    object=name,
                )
        return None

    def _handled(self, scene: Scene) -> set[str]:
        """What is held or touched on purpose. An arm that only comes close to a thing must not move it."""
        found = {name for name in scene.held if name is not None}
        for agent in self._plan.task.agents:
            position = self._plan.position_now(agent, scene)
            segment = self._plan.segment_at(agent, position) if position > 0 else None
            if segment is not None and segment.primitive != "approach":
                found |= segment.touches
        return found
