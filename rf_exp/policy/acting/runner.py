"""Some agents that are given their targets in chunks, whoever predicts them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.acting.targets import Targets
from rf_exp.policy.inputs.view import View
from rf_exp.types import Scene, Sight


@dataclass
class RunnerState:
    """What a runner remembers of an episode, and what it says to others about it."""

    targets: Targets
    kept: bool = False  # whether an agent was kept from its target in the last step
    # agent -> (T, 8) targets predicted in the last call, from its step on; empty if it predicted nothing
    predicted: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    seen: tuple[Sight, ...] = ()  # at the last look
    # agent -> number of its subgoal and whether it may go on, as it said in the last prediction
    phases: dict[int, tuple[int, bool]] = field(default_factory=dict)
    # What a coordinator says now: the numbers of the subgoals (N,) and who may go on (N,).
    coordinated: tuple[NDArray[np.int64], NDArray[np.bool_]] | None = None


class PolicyRunner:
    """Some agents that are given their targets in chunks, and what is common to all who predict them."""

    def __init__(self, view: View, fastest_rad: NDArray[np.float64]) -> None:
        """`fastest_rad` (agents of the view,): the largest change of a joint in a control step."""
        self.view, self._fastest_rad = view, fastest_rad
        self.state = RunnerState(Targets(fastest_rad))

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.state = RunnerState(Targets(self._fastest_rad))

    @property
    def looks(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return False

    def observe(self, scene: Scene, pictures: Mapping[str, NDArray[np.uint8]]) -> None:
        """Take in the present moment, at every control step and before a prediction."""

    def predict(self, scene: Scene) -> NDArray[np.float64]:
        """Targets (T, agents of the view, 8) from this control step on."""
        raise NotImplementedError

    def __call__(self, scene: Scene, pictures: Mapping[str, NDArray[np.uint8]]) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step; `pictures` matter when it looks."""
        self.think(scene, pictures)
        return self.act()

    def think(self, scene: Scene, pictures: Mapping[str, NDArray[np.uint8]]) -> None:
        """Look, and predict where an agent has nothing left to do: then for all agents of the view."""
        self.state.predicted = {}
        self.state.targets.start(scene.qpos[np.array(self.view.agents) - 1])
        self.observe(scene, pictures)
        if not self.state.targets:
            chunk = self.predict(scene)
            self.state.targets.put(chunk)
            self.state.predicted = {agent: chunk[:, row] for row, agent in enumerate(self.view.agents)}

    def ahead(self) -> dict[int, NDArray[np.float64]]:
        """Agent -> (T, 8) commands from this control step on, if nobody keeps it from them."""
        return dict(zip(self.view.agents, self.state.targets.ahead(), strict=True))

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step: its own, or what was decided."""
        agents = self.view.agents
        if decision is None:
            commands: NDArray[np.float64] = np.concatenate(self.state.targets.ahead(1))
            self.state.targets.given(commands)
            return commands
        commands = decision.commands[np.array(agents) - 1]
        kept = [row for row, agent in enumerate(agents) if agent in decision.withheld]
        self.state.targets.given(commands, kept)
        self.state.kept = bool(kept)
        for row, agent in enumerate(agents):
            if agent in decision.anew:
                self.state.targets.forget(row)
        return commands
