"""PettingZoo environment: one agent per arm, all acting at once."""

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from rf_exp.envs.core import METADATA, BaseEnv, checked_action
from rf_exp.envs.observations import (
    action_space,
    agent_extractor,
    observation_space,
    state_space,
    state_vector,
)
from rf_exp.errors import ArgumentError
from rf_exp.observations import ObservationDict, Observations
from rf_exp.tasks import Task

PerAgent = dict[str, Any]  # agent -> value


class ParallelArmsEnv(BaseEnv, ParallelEnv[str, ObservationDict, NDArray[np.float32]]):
    """Environment of a task for the agents `agent1` to `agent<N>`: `rf_exp.envs.parallel_env("<task>")`.

    Actions of each (A,) float32: absolute joint targets in rad and the gripper in [-1 closed, 1 open],
    clipped to their limits. Observations of each, selected by `Observations`: with state `joints` its own
    (D,), with `full` those of all arms (N, D), its own in the first row, and the objects; and two cameras,
    `global` and its own, called `local`. All share the reward, 1 for success by the strict criterion, else 0,
    and end together. Arguments and errors are those of `EpisodeCore`.
    """

    def __init__(
        self, task: str | Path | Task, observations: Observations | None = None, **options: Any
    ) -> None:
        super().__init__(task, observations, **options)
        self.metadata = METADATA | {"name": f"rf_exp_{self.task.name}", "is_parallelizable": True}
        numbers = {f"agent{agent}": agent for agent in self.task.agents}
        observations = self.core.observations
        self.possible_agents = list(numbers)
        self.agents: list[str] = []
        self.action_spaces: PerAgent = {
            name: action_space(self.task, agent) for name, agent in numbers.items()
        }
        self.observation_spaces: PerAgent = {
            name: observation_space(observations, self.task, k) for name, k in numbers.items()
        }
        self.state_space = state_space(self.task)
        self._extractors = {
            name: agent_extractor(observations, self.task, agent) for name, agent in numbers.items()
        }
        self._rng: np.random.Generator | None = None

    def observation_space(self, agent: str) -> spaces.Dict:
        """Space of an agent; equal for all, but each with its own random numbers."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """Space (A,) of an agent, each with its own random numbers."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[PerAgent, PerAgent]:
        """Resets to the scene of exactly this seed, else to a drawn one; info holds its seed."""
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        self.core.reset(seed, self._rng)
        self.agents = self.possible_agents[:]
        return self._observed(), self._infos()

    def step(
        self, actions: PerAgent
    ) -> tuple[PerAgent, dict[str, float], dict[str, bool], dict[str, bool], PerAgent]:
        """Observations, rewards, terminated, truncated, infos. Raises ArgumentError for a missing action."""
        agents = self.possible_agents
        if self.agents and actions.keys() != self._extractors.keys():
            raise ArgumentError(f"actions of {sorted(actions)}; expected one of each of {agents}")
        try:
            self.core.step([actions[name] for name in self.agents])
        except ArgumentError:
            for name in agents:  # finds the invalid one
                checked_action(actions[name], self.action_space(name).shape, f"action of {name}")
            raise
        episode = self.core.episode
        if episode.terminated or episode.truncated:
            self.agents = []
        flags = (dict.fromkeys(agents, episode.terminated), dict.fromkeys(agents, episode.truncated))
        return self._observed(), dict.fromkeys(agents, episode.reward), *flags, self._infos()

    def _observed(self) -> PerAgent:
        observation = self.core.observe()
        return {name: extract(observation) for name, extract in self._extractors.items()}

    def _infos(self) -> PerAgent:
        return {name: self.core.episode.info() for name in self.possible_agents}

    def state(self) -> NDArray[np.float32]:
        """All joints, velocities and object poses, whatever is observed: for a centralised critic."""
        return state_vector(self.core.episode.scene)
