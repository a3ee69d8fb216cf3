"""A plan as it was carried out, for whoever judges it afterwards."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.plan import Plan
from rf_exp.types import CONTROL_DT_S, Scene


@dataclass(frozen=True)
class Signal:
    """A number at every control step of an execution. The same name is the same number."""

    name: str  # an identifier
    unit: str  # empty for a condition, which is VOID where it is true and -VOID where not
    how: str  # it is computed from what was recorded
    of: "Callable[[Execution], NDArray[np.float64]]"  # (T,)


class Execution:
    """The control steps of a plan that its monitor has judged."""

    def __init__(self, plan: Plan, scenes: Sequence[Scene]) -> None:
        """`scenes` (T,): as measured after each control step, from the first one of the plan on."""
        self.plan, self.scenes = plan, tuple(scenes)
        self._evidence: dict[Check, list[Evidence | None]] = {}
        self._values: dict[str, NDArray[np.float64]] = {}

    def __len__(self) -> int:
        return len(self.scenes)

    @property
    def clock_s(self) -> NDArray[np.float64]:
        """(T,) since the plan began."""
        return np.arange(1, len(self) + 1, dtype=float) * CONTROL_DT_S

    def positions(self, agent: int) -> NDArray[np.int64]:
        """(T,) path position that the agent was sent to in each control step."""
        return self.plan.positions(agent)[1 : len(self) + 1]

    def measured(self, check: Check) -> list[Evidence | None]:
        """(T,) what the check says of the real state at each control step."""
        if check not in self._evidence:
            self._evidence[check] = [check.measured(scene, self.plan) for scene in self.scenes]
        return self._evidence[check]

    def values(self, signal: Signal) -> NDArray[np.float64]:
        """(T,) of a signal."""
        if signal.name not in self._values:
            self._values[signal.name] = signal.of(self)
        return self._values[signal.name]
