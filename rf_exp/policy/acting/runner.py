"""Runner: some agents that are given their targets in chunks, whoever predicts them from an observation."""

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.observations import Declaration, Observation
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.inputs.view import View
from rf_exp.types import ARM_JOINTS, KeypointDetection


class Targets:
    """A queue of predicted targets for each agent of a runner, in the order of its view.

    A target further away than the demonstrations ever moved in a control step is approached by linear
    interpolation in joint space. An agent that was kept from its target has it still before it, so agents
    may have different numbers of them.
    """

    def __init__(self, fastest_rad: NDArray[np.float64]) -> None:
        self._fastest_rad = fastest_rad  # (agents,) a control step
        self._queues = [deque[NDArray[np.float64]]() for _ in fastest_rad]  # of (8,)
        self._last: NDArray[np.float64] | None = None  # (agents, 7) arm targets given last

    def __len__(self) -> int:
        """The targets left for the agent that has the fewest."""
        return min(map(len, self._queues))

    @property
    def last(self) -> NDArray[np.float64]:
        """(agents, 7) the arm targets given last, or where motion begins."""
        assert self._last is not None
        return self._last

    def start(self, qpos: NDArray[np.float64]) -> None:
        """Measured joints (agents, 9), where motion begins; nothing once it has begun."""
        if self._last is None:
            self._last = qpos[:, :ARM_JOINTS]

    def put(self, chunk: NDArray[np.float64]) -> None:
        """Targets (T, agents, 8) from now on, instead of what was left."""
        self._queues = [deque(chunk[:, row]) for row in range(chunk.shape[1])]

    def forget(self, row: int) -> None:
        """Drop what is left for one agent, so that a prediction is due."""
        self._queues[row].clear()

    def ahead(self, steps: int | None = None) -> list[NDArray[np.float64]]:
        """The commands (T, 8) of each agent from this control step on, as they will be given."""
        assert self._last is not None  # motion has begun
        found = []
        for queue, last, fastest in zip(self._queues, self._last, self._fastest_rad, strict=True):
            rows = []
            for target in list(queue)[:steps]:
                change = target[:ARM_JOINTS] - last
                part = fastest / np.maximum(np.abs(change).max(), fastest + 1e-12)  # at most 1
                last = last + part * change
                rows.append(np.append(last, np.clip(target[ARM_JOINTS], -1.0, 1.0)))
            found.append(np.array(rows))
        return found

    def given(self, commands: NDArray[np.float64], kept: Collection[int] = ()) -> None:
        """What was commanded, (agents, 8); the rows in `kept` were kept from their targets."""
        self._last = commands[:, :ARM_JOINTS].copy()
        for row, queue in enumerate(self._queues):
            if row not in kept:
                queue.popleft()


@dataclass
class RunnerState:
    """What a runner remembers of an episode, and what it says to others about it."""

    targets: Targets
    kept: bool = False  # whether an agent was kept from its target in the last step
    # agent -> (T, 8) targets predicted in the last call, from its step on; empty if it predicted nothing
    predicted: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    detections: tuple[KeypointDetection, ...] = ()  # in the last pictures
    # agent -> number of its subgoal and whether it may go on, as it said in the last prediction
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


class PolicyRunner:
    """Some agents that are given their targets in chunks, and what is common to all who predict them.

    At every control step it is handed an observation of what it `declares`, and nothing else of the scene.
    """

    def __init__(
        self, view: View, fastest_rad: NDArray[np.float64], declared: Declaration | None = None
    ) -> None:
        """`fastest_rad` (agents of the view,): the largest change of a joint in a control step.

        It observes what is `declared`, or the joints of its agents, which it needs in any case.
        """
        self.view, self._fastest_rad = view, fastest_rad
        self._declared = declared or Declaration(view.agents)
        self.state = RunnerState(Targets(fastest_rad))

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.state = RunnerState(Targets(self._fastest_rad))

    @property
    def looks(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return False

    @property
    def declares(self) -> Declaration:
        """What it is to be handed at this control step: without cameras, unless it looks."""
        return self._declared if self.looks else replace(self._declared, cameras=())

    def observe(self, observation: Observation) -> None:
        """Take in the present moment, at every control step and before a prediction."""

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """Targets (T, agents of the view, 8) from this control step on."""
        raise NotImplementedError

    def __call__(self, observation: Observation) -> NDArray[np.float64]:
        """Commands (agents of the view, 8) for this control step."""
        self.think(observation)
        return self.act()

    def think(self, observation: Observation) -> None:
        """Observe, and predict where an agent has nothing left to do: then for all agents of the view."""
        self.state.predicted = {}
        self.state.targets.start(np.stack([observation.qpos[agent] for agent in self.view.agents]))
        self.observe(observation)
        if not self.state.targets:
            chunk = self.predict(observation)
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
