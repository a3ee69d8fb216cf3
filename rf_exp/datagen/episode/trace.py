"""What the monitor of an episode saw, kept by an observer: nothing is computed before somebody asks."""

from collections.abc import Mapping
from math import inf

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.stl import Execution
from rf_exp.datagen.episode.observer import NullObserver
from rf_exp.datagen.planning import Planned
from rf_exp.findings import Violation
from rf_exp.types import CONTROL_HZ, Scene


class Trace(NullObserver):
    """An observer of the generation loop; afterwards it has an `Execution` of every plan."""

    def __init__(self) -> None:
        self._scenes: list[Scene] = []
        self._plans: list[Planned] = []
        self._stopped: list[float] = []  # control step of the violation that ended each plan

    def planned(self, plan: Planned) -> None:
        self._plans.append(plan)
        self._stopped.append(inf)

    def rejected(self, violation: Violation) -> None:
        if self._plans:  # one that was refused before anything moved is later than the last plan's end
            self._stopped[-1] = min(self._stopped[-1], round(violation.time_s * CONTROL_HZ))

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        self._scenes.append(scene)

    def executions(self) -> list[tuple[Planned, Execution]]:
        """Every plan with the control steps that its monitor has judged.

        The step that ended in success is not among them: nobody had to judge it any more.
        """
        found = []
        for made, stopped in zip(self._plans, self._stopped, strict=True):
            plan = made.checked.plan
            begins = plan.scene.step
            ends = min(begins + len(plan.schedule), stopped)
            scenes = [scene for scene in self._scenes if begins < scene.step <= ends]
            found.append((made, Execution(plan, scenes)))
        return found
