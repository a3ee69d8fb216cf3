"""Foreign runner: somebody's policy in the rollout loop; all it gives is checked before an arm moves."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import RfError, StageError
from rf_exp.observations import Observation
from rf_exp.policy.acting.rollouts import PolicyRunner
from rf_exp.policy.foreign.factory import make_policy
from rf_exp.policy.foreign.spec import Foreign
from rf_exp.policy.inputs.rows import GRIPPER, wide
from rf_exp.policy.inputs.view import ACTION_SIZE, Stream, View
from rf_exp.tasks import Task
from rf_exp.types import ARM_JOINTS


class ForeignRunner(PolicyRunner):
    """One policy of all agents: an observation in, a chunk of absolute targets out, when the last is used up.

    The policy is given what `foreign.observations` says; the runner itself knows the joints in any case.
    Raises StageError, which says where in which scene, for a policy that raises and for actions of another
    shape or type or that are not finite.
    """

    def __init__(self, spec: Foreign, policy: Any, task: Task, fastest_rad: float) -> None:
        """`policy` has `act`, perhaps `reset`; no joint is sent further than `fastest_rad` a control step."""
        self._spec, self._policy = spec, policy
        self._seed, self._begun = 0, False  # of the episode, and whether the policy has been told of it
        limits = [np.column_stack([robot.model.limits_rad, [-1.0, 1.0]]) for robot in task.robots]
        self._low, self._high = np.stack([wide(each, GRIPPER) for each in limits], axis=1)  # (agents, 8)
        everyone = View(spec.name, (Stream("global", task.agents),))
        declared = replace(spec.observations.declared(task), agents=task.agents)
        super().__init__(everyone, np.full(len(task.agents), fastest_rad), declared)

    def reset(self, seed: int) -> None:
        """An episode begins; the policy is told before its first prediction."""
        super().reset(seed)
        self._seed, self._begun = seed, False

    @property
    def looks(self) -> bool:
        """Whether a chunk is used up, so that the policy is asked for another one."""
        return not self.state.targets

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """The chunk (T, agents, 8) of the policy, checked, and clipped to the limits of the joints."""
        where = f"policy {self._spec.name!r}, scene {self._seed}, control step {observation.step}: "
        try:
            if not self._begun and callable(reset := getattr(self._policy, "reset", None)):
                reset(self._seed)
            self._begun = True
            shown = self._spec.observations.keyed(observation)
            chunk = checked(self._policy.act(shown), len(self.view.agents))
        except RfError as error:
            raise StageError(where + str(error)) from error
        except Exception as error:  # whatever a policy raises
            raise StageError(f"{where}it raised {type(error).__name__}: {error}") from error
        return chunk[: self._spec.action_steps].clip(self._low, self._high)


def checked(answer: object, agents: int) -> NDArray[np.float64]:
    """What a policy gave, as a chunk (T, agents, 8). Raises StageError for anything else."""
    each = f"seven joint targets in rad and the gripper in [-1, 1] of {agents} agent{'s' * (agents > 1)}"
    size = ACTION_SIZE * agents
    expected = f"expected finite numbers (T, {agents}, {ACTION_SIZE}) or (T, {size}): {each}"
    try:
        array = np.asarray(answer)
    except Exception as error:  # a tensor elsewhere, lists of different lengths
        raise StageError(
            f"actions that are no array ({type(answer).__name__}: {error}); {expected}"
        ) from error
    if array.dtype.kind not in "iuf":
        raise StageError(f"actions of type {array.dtype} ({type(answer).__name__}); {expected}")
    if not len(array.shape) or not len(array) or array.shape[1:] not in {(agents, ACTION_SIZE), (size,)}:
        raise StageError(f"actions of shape {array.shape}; {expected}")
    chunk = array.reshape(-1, agents, ACTION_SIZE).astype(float)
    if not np.isfinite(chunk).all():
        step, row, joint = np.argwhere(~np.isfinite(chunk))[0].tolist()
        which = "gripper" if joint == ARM_JOINTS else f"joint {joint + 1}"
        raise StageError(
            f"{which} of agent {row + 1} is {chunk[step, row, joint]} in step {step} of a chunk of "
            f"{len(chunk)}; {expected}"
        )
    return chunk


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
