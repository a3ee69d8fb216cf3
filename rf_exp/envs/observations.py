"""Spaces of the observations of environments (`rf_exp.observations`), and the part of a single agent.

A single agent has the camera `global` and its own, which is called `local` for every agent, so that all
agents have one space.
"""

from collections.abc import Callable, Sequence

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rf_exp.observations import ObservationDict, Observations
from rf_exp.sim import FAR_M
from rf_exp.tasks import Task, label_names
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import FINGERS, GRIPPER_CLOSED, GRIPPER_OPEN, Scene, camera_names, fingers_of

OVERSHOOT = 0.1  # rad, m: how far a pushed joint may be measured beyond its limit


def action_space(task: Task, agent: int | None = None) -> spaces.Box:
    """Actions (A,) of one agent, or (agents, A): joint targets within limits in rad, gripper in [-1, 1]."""
    bounds = np.zeros((2, len(task.agents), task.dof + 1))
    bounds[..., -1] = [[GRIPPER_CLOSED], [GRIPPER_OPEN]]
    for row, robot in enumerate(task.robots):
        bounds[:, row, : robot.model.dof] = robot.model.limits_rad
    low, high = bounds.astype(np.float32) if agent is None else bounds[:, agent - 1].astype(np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def observation_space(observations: Observations, task: Task, agent: int | None = None) -> spaces.Dict:
    """The observation space of one controller of all arms, or of one agent."""
    cameras = camera_names(observations.cameras, 1 if agent is not None else len(task.agents))
    names = [name.replace("agent1", "local") for name in cameras] if agent is not None else cameras
    parts: dict[str, spaces.Space] = {}
    if observations.state != "none":
        order = task.agents if agent is None else _own_first(task, agent)
        joints = _qpos_space(task, order)
        if agent is not None and observations.state == "joints":
            joints = spaces.Box(joints.low[0], joints.high[0], dtype=np.float32)
        parts |= {"qpos": joints, "qvel": _unbounded(joints.shape)}
    if observations.state == "full":
        bound = np.array([np.inf] * 3 + [1.0] * 4, np.float32)
        parts |= {f"pose_{name}": spaces.Box(-bound, bound, dtype=np.float32) for name in task.objects}
    size = (observations.height, observations.width)
    if observations.pictures:
        parts |= {f"rgb_{name}": spaces.Box(0, 255, (*size, 3), np.uint8) for name in names}
    if observations.depth:
        parts |= {f"depth_{name}": spaces.Box(0.0, FAR_M, size, np.float32) for name in names}
    if observations.segmentation:
        largest_label = len(label_names(task)) - 1
        parts |= {f"segmentation_{name}": spaces.Box(0, largest_label, size, np.uint8) for name in names}
    if observations.calibration:
        poses = {"world_from_base": (len(task.agents), 4, 4)}
        poses |= {f"world_from_camera_{name}": (4, 4) for name in names}
        poses |= {f"intrinsics_{name}": (3, 3) for name in names}
        parts |= {key: _unbounded(shape) for key, shape in poses.items()}
    if observations.language:
        count = len(task.description)
        parts["language"] = spaces.Text(count, min_length=count, charset=frozenset(task.description))
    return spaces.Dict(parts)


def _own_first(task: Task, agent: int) -> tuple[int, ...]:
    return (agent, *(other for other in task.agents if other != agent))


def _qpos_space(task: Task, order: Sequence[int]) -> spaces.Box:
    bounds = np.zeros((2, len(order), task.dof + FINGERS))
    for row, agent in enumerate(order):
        model = task.robots[agent - 1].model
        bounds[:, row, : model.dof] = model.limits_rad
        fingers_of(bounds)[1, row] = model.hand.open_m
    low, high = (bounds + np.array([-OVERSHOOT, OVERSHOOT])[:, None, None]).astype(np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def _unbounded(shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def agent_extractor(
    observations: Observations, task: Task, agent: int
) -> Callable[[ObservationDict], ObservationDict]:
    """Function from the observation of one controller to that of this agent, in arrays of its own.

    Arrays shared by several agents are copied for all but the last one, which gets the originals. With state
    `full` the rows of joints are the agent's own first, then the others'.
    """
    order = np.array(_own_first(task, agent)) - 1
    kinds = "rgb", "depth", "segmentation", "world_from_camera", "intrinsics"
    local = {f"{kind}_local": f"{kind}_agent{agent}" for kind in kinds}
    several = len(task.agents) > 1
    joint_keys = {"qpos", "qvel"} if observations.state == "joints" or several else set[str]()
    unshared = (
        {"language", *local}
        if agent < len(task.agents)
        else set(observation_space(observations, task, agent))
    )

    def own_first(rows: NDArray[np.float32]) -> NDArray[np.float32]:
        return rows.take(order, axis=0)

    def conversion(key: str) -> Callable[[NDArray], NDArray] | None:
        if key in joint_keys:
            return (lambda rows: rows[agent - 1].copy()) if observations.state == "joints" else own_first
        if key == "world_from_base" and several:
            return own_first
        return None if key in unshared else np.ndarray.copy

    parts = [
        (key, local.get(key, key), conversion(key)) for key in observation_space(observations, task, agent)
    ]

    def extract(observation: ObservationDict) -> ObservationDict:
        return {
            key: observation[name] if convert is None else convert(observation[name])
            for key, name, convert in parts
        }

    return extract


def state_vector(scene: Scene) -> NDArray[np.float32]:
    """All joints, their velocities and the poses of all objects, concatenated (2 N D + 7 K,)."""
    poses = [position_and_quaternion(pose) for pose in scene.poses.values()]
    return np.concatenate([scene.qpos.ravel(), scene.qvel.ravel(), *poses]).astype(np.float32)


def state_space(task: Task) -> spaces.Box:
    """The space of `state_vector`."""
    return _unbounded((2 * (task.dof + FINGERS) * len(task.agents) + 7 * len(task.objects),))
