"""Foreign runner: a foreign policy in the rollout loop; its output is checked before an arm moves."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp import client
from rf_exp.errors import RfError, StageError
from rf_exp.observations import Observation
from rf_exp.policy.acting.rollouts import PolicyRunner
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.foreign.factory import make_policy
from rf_exp.policy.foreign.spec import Foreign
from rf_exp.policy.inputs.rows import GRIPPER, with_padding
from rf_exp.policy.inputs.view import Stream, View
from rf_exp.tasks import Task
from rf_exp.types import ARM_JOINTS, GRIPPER_OPEN


class ForeignRunner(PolicyRunner):
    """One policy of all agents: an observation in, a chunk of absolute targets out, when the last is used up.

    The policy gets what `foreign.observations` selects; the runner itself needs the joints in any case. A
    policy with `observe` gets the last `observation_steps` control steps up to that of the call, with the
    commands before each. Raises StageError, which names scene and control step, for a policy that raises and
    for actions of another shape or type or that are not finite.
    """

    def __init__(self, spec: Foreign, policy: Any, task: Task, fastest_rad: float) -> None:
        """`policy` has `act`, and optionally `reset` and `observe`.

        No joint is moved further than `fastest_rad` per control step.
        """
        self._spec, self._policy = spec, policy
        self._has_observe = callable(getattr(policy, "observe", None))
        self._observation_steps = getattr(policy, "observation_steps", 1) if self._has_observe else 1
        self._last_commands: NDArray[np.float64] | None = None  # (agents, 8) in the control step before
        self._seed, self._was_reset = 0, False  # of the episode, and whether the policy was reset for it
        limits = [np.column_stack([robot.model.limits_rad, [-1.0, 1.0]]) for robot in task.robots]
        self._low, self._high = np.stack(
            [with_padding(each, GRIPPER) for each in limits], axis=1
        )  # (agents, 8)
        view = View(spec.name, (Stream("global", task.agents),))
        declared = replace(spec.observations.declaration_for(task), agents=task.agents)
        super().__init__(view, np.full(len(task.agents), fastest_rad), declared)

    def reset(self, seed: int) -> None:
        """Start an episode; the policy is reset before its first prediction."""
        super().reset(seed)
        self._seed, self._was_reset, self._last_commands = seed, False, None

    @property
    def needs_pictures(self) -> bool:
        """Whether the chunk is used up, or, for a policy with several observation steps, is about to be."""
        any_step = self.state.withheld and self._observation_steps > 1  # after a withheld command
        return any_step or len(self.state.targets) < self._observation_steps

    def observe(self, observation: Observation) -> None:
        """Pass the observation to a policy with several observation steps."""
        if self._has_observe and self.needs_pictures:
            with self._error_context(observation):
                self._policy.observe(self._policy_observation(observation))

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """The chunk (T, agents, 8) of the policy, checked, and clipped to the limits of the joints."""
        with self._error_context(observation):
            answer = self._policy.act(self._policy_observation(observation))
            try:
                chunk = client.validate_chunk(answer, len(self.view.agents))
            except ValueError as error:
                raise StageError(*error.args) from error
        return chunk[: self._spec.action_steps].clip(self._low, self._high)

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8), as in `PolicyRunner`; records them."""
        self._last_commands = super().act(decision)
        return self._last_commands

    def _policy_observation(self, observation: Observation) -> dict[str, Any]:
        """The observation in the format of the policy."""
        result = self._spec.observations.as_dict(observation)
        if self._has_observe:
            last_commands = self._last_commands
            if last_commands is None:  # at first: measured joints, open grippers
                joints = np.stack([observation.qpos[agent] for agent in self.view.agents])[:, :ARM_JOINTS]
                last_commands = np.column_stack([joints, np.full(len(joints), GRIPPER_OPEN)])
            result["commanded"] = last_commands.astype(np.float32)
        return result

    @contextmanager
    def _error_context(self, observation: Observation) -> Iterator[None]:
        """Reset the policy at the start of an episode; add policy, scene and step to whatever it raises."""
        where = f"policy {self._spec.name!r}, scene {self._seed}, control step {observation.step}: "
        try:
            if not self._was_reset and callable(reset := getattr(self._policy, "reset", None)):
                reset(self._seed)
            self._was_reset = True
            yield
        except RfError as error:
            raise StageError(where + str(error)) from error
        except Exception as error:  # whatever a policy raises
            raise StageError(f"{where}it raised {type(error).__name__}: {error}") from error


def foreign_runners(spec: Foreign, fastest_rad: float, task: Task) -> tuple[PolicyRunner, ...]:
    """The runner of a foreign policy, which is created, or connected to, once per process."""
    return (ForeignRunner(spec, _policy(spec), task, fastest_rad),)


@lru_cache(maxsize=1)
def _policy(spec: Foreign) -> Any:
    if spec.server is None:
        assert spec.factory is not None
        return make_policy(spec.factory, spec.options)
    try:
        from rf_exp.policy.foreign.remote import Remote  # a factory needs no websockets
    except ModuleNotFoundError as error:
        if error.name not in ("websockets", "msgpack"):
            raise
        raise StageError(
            f"foreign.server needs {error.name}, which is not installed; run: pip install 'rf_exp[foreign]'"
        ) from error
    return Remote(spec.server, spec.connect_s, spec.answer_s)
