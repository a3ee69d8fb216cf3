"""Arms driven along plans, and watched: for demonstrations, and for whoever has a plan of the library."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import actions, alike
from rf_exp.datagen.motion import come_to_rest, let_off
from rf_exp.datagen.planning import Planned
from rf_exp.findings import CheckName, Violation
from rf_exp.types import JointLimits, Scene

Command = NDArray[np.float64]  # (N, A): joint targets in rad and grippers, for a control step
Commands = NDArray[np.float64]  # (K, N, A)


class Arms(Protocol):
    """All arms of a scene, which take one command after the other."""

    @property
    def scene(self) -> Scene:
        """As it was measured last."""
        ...

    @property
    def told(self) -> Command | None:
        """The last command; None before the first."""
        ...

    @property
    def over(self) -> bool:
        """Whether they are to take no more."""
        ...

    def take(self, command: Command) -> None:
        """One control step."""
        ...


def commands_of(plan: Planned) -> Commands:
    """(T + 1, N, A): where the arms begin, and what the plan sends them in each control step."""
    return from_start(plan, actions(plan.executed, plan.schedule))


def from_start(plan: Planned, commands: Commands) -> Commands:
    """Commands of a plan (T, N, A) behind a row of where its arms begin (T + 1, N, A)."""
    start = alike([trajectory.path()[:1] for trajectory in plan.trajectories])
    return np.concatenate([np.stack(start, axis=1), commands])


def follow(arms: Arms, commands: Commands) -> None:
    """Carries out commands until it is over."""
    for command in commands:
        if arms.over:
            break
        arms.take(command)


def drive(
    arms: Arms,
    commands: Commands,
    monitor: Callable[[Scene], Violation | None],
    limits: JointLimits,
    take: Callable[[int], None] | None = None,
    rest: Callable[[int], None] | None = None,
) -> Violation | None:
    """Carries out the `commands_of` a plan until it is over, or its monitor objects to a control step.

    Then everybody comes to rest along the plan, and arms that have hit something no longer push. `take` takes
    a step of the plan, by its row; without it the command of that row is taken. `rest` comes to rest after a
    row; without it the commands do.
    """
    for now in range(1, len(commands)):
        if take is None:
            arms.take(commands[now])
        else:
            take(now)
        if arms.over:
            break
        violation = monitor(arms.scene)
        if violation is not None:
            if rest is None:
                follow(arms, come_to_rest(commands, now, limits))
            else:
                rest(now)
            if violation.check is CheckName.COLLISION and arms.told is not None:
                follow(arms, let_off(arms.told, arms.scene.qpos, violation.agents, limits))
            return violation
    return None
