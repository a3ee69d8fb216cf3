"""Foreign runner: somebody's policy in the rollout loop; all it gives is checked before an arm moves."""

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

    The policy is given what `foreign.observations` says; the runner itself knows the joints in any case. One
    that has `observe` is shown the last `observation_steps` control steps up to that of the call, and what
    the arms were told before each.
    Raises StageError, which says where in which scene, for a policy that raises and for actions of another
    shape or type or that are not finite.
    """

    def __init__(self, spec: Foreign, policy: Any, task: Task, fastest_rad: float) -> None:
        """`policy` has `act`, perhaps `reset` and `observe`.

        No joint is sent further than `fastest_rad` a control step.
        """
        self._spec, self._policy = spec, policy
        self._watches = callable(getattr(policy, "observe", None))
        self._moments = getattr(policy, "observation_steps", 1) if self._watches else 1
        self._commanded: NDArray[np.float64] | None = None  # (agents, 8) in the control step before
        self._seed, self._begun = 0, False  # of the episode, and whether the policy has been told of it
        limits = [np.column_stack([robot.model.limits_rad, [-1.0, 1.0]]) for robot in task.robots]
        self._low, self._high = np.stack([wide(each, GRIPPER) for each in limits], axis=1)  # (agents, 8)
        everyone = View(spec.name, (Stream("global", task.agents),))
        declared = replace(spec.observations.declared(task), agents=task.agents)
        super().__init__(everyone, np.full(len(task.agents), fastest_rad), declared)

    def reset(self, seed: int) -> None:
        """An episode begins; the policy is told before its first prediction."""
        super().reset(seed)
        self._seed, self._begun, self._commanded = seed, False, None

    @property
    def looks(self) -> bool:
        """Whether a chunk is used up, or is about to be for a policy that looks at several moments."""
        any_step = self.state.kept and self._moments > 1  # who was kept may be asked at any
        return any_step or len(self.state.targets) < self._moments

    def observe(self, observation: Observation) -> None:
        """Shows the present moment to a policy that looks at several."""
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
        """Commands (agents of the view, 8), as `PolicyRunner` gives them; remembers them."""
        self._commanded = super().act(decision)
        return self._commanded

    def _shown(self, observation: Observation) -> dict[str, Any]:
        """What the policy is given of the present moment."""
        shown = self._spec.observations.keyed(observation)
        if self._watches:
            commanded = self._commanded
            if commanded is None:  # nothing yet: the arms stay, with open grippers
                joints = np.stack([observation.qpos[agent] for agent in self.view.agents])[:, :ARM_JOINTS]
                commanded = np.column_stack([joints, np.full(len(joints), GRIPPER_OPEN)])
            shown["commanded"] = commanded.astype(np.float32)
        return shown

    @contextmanager
    def _blames(self, observation: Observation) -> Iterator[None]:
        """Tells a policy that an episode has begun; says of whatever it raises where that was."""
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
    """Who acts in the scenes of a task; its policy is made, or asked for, once a process."""
    return (ForeignRunner(spec, _policy(spec), task, fastest_rad),)


@lru_cache(maxsize=1)
def _policy(spec: Foreign) -> Any:
    if spec.server is None:
        assert spec.factory is not None
        return make_policy(spec.factory, spec.options)
    try:
        from rf_exp.policy.foreign.remote import Remote  # not above: a factory does without websockets
    except ModuleNotFoundError as error:
        if error.name not in ("websockets", "msgpack"):
            raise
        raise StageError(
            f"foreign.server needs {error.name}, which is not installed; run: pip install 'rf_exp[foreign]'"
        ) from error
    return Remote(spec.server, spec.connect_s, spec.answer_s)
