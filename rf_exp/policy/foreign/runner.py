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
from rf_exp.policy.inputs.rows import GRIPPER, wide
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
        self._watches = callable(getattr(policy, "observe", None))
        self._moments = getattr(policy, "observation_steps", 1) if self._watches else 1
        self._commanded: NDArray[np.float64] | None = None  # (agents, 8) in the control step before
        self._seed, self._begun = 0, False  # of the episode, and whether the policy was reset for it
        limits = [np.column_stack([robot.model.limits_rad, [-1.0, 1.0]]) for robot in task.robots]
        self._low, self._high = np.stack([wide(each, GRIPPER) for each in limits], axis=1)  # (agents, 8)
        everyone = View(spec.name, (Stream("global", task.agents),))
        declared = replace(spec.observations.declared(task), agents=task.agents)
        super().__init__(everyone, np.full(len(task.agents), fastest_rad), declared)

    def reset(self, seed: int) -> None:
        """Start an episode; the policy is reset before its first prediction."""
        super().reset(seed)
        self._seed, self._begun, self._commanded = seed, False, None

    @property
    def looks(self) -> bool:
        """Whether the chunk is used up, or, for a policy with several observation steps, is about to be."""
        any_step = self.state.kept and self._moments > 1  # after a withheld command
        return any_step or len(self.state.targets) < self._moments

    def observe(self, observation: Observation) -> None:
        """Pass the observation to a policy with several observation steps."""
        if self._watches and self.looks:
            with self._blames(observation):
                self._policy.observe(self._shown(observation))

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """The chunk (T, agents, 8) of the policy, checked, and clipped to the limits of the joints."""
        with self._blames(observation):
            answer = self._policy.act(self._shown(observation))
            try:
                chunk = client.checked(answer, len(self.view.agents))
            except ValueError as error:
                raise StageError(*error.args) from error
        return chunk[: self._spec.action_steps].clip(self._low, self._high)

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8), as in `PolicyRunner`; records them."""
        self._commanded = super().act(decision)
        return self._commanded

    def _shown(self, observation: Observation) -> dict[str, Any]:
        """The observation in the format of the policy."""
        shown = self._spec.observations.keyed(observation)
        if self._watches:
            commanded = self._commanded
            if commanded is None:  # at first: measured joints, open grippers
                joints = np.stack([observation.qpos[agent] for agent in self.view.agents])[:, :ARM_JOINTS]
                commanded = np.column_stack([joints, np.full(len(joints), GRIPPER_OPEN)])
            shown["commanded"] = commanded.astype(np.float32)
        return shown

    @contextmanager
    def _blames(self, observation: Observation) -> Iterator[None]:
        """Reset the policy at the start of an episode; add policy, scene and step to whatever it raises."""
        where = f"policy {self._spec.name!r}, scene {self._seed}, control step {observation.step}: "
        try:
            if not self._begun and callable(reset := getattr(self._policy, "reset", None)):
                reset(self._seed)
            self._begun = True
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
