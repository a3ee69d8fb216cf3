"""What environments show of `rf_exp.observations`: spaces, and the part of a single agent.

An agent of its own sees through `global` and through its own camera, which is called `local` for every
agent, so that all agents have one space.
"""

from collections.abc import Callable

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rf_exp.observations import ObservationDict, Observations
from rf_exp.robots import limits_rad
from rf_exp.sim import FAR_M
from rf_exp.tasks import FINGERS_OPEN_M, Task, labels
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Scene, camera_names

OVERSHOOT = 0.1  # rad, m: so far beyond its limit a joint may be measured that something pushes


def action_space(agents: int | None = None) -> spaces.Box:
    """(8,) of one arm, or (agents, 8): joint targets within the Panda's limits in rad, gripper in [-1, 1]."""
    low, high = limits_rad()
    bounds = np.append(low, GRIPPER_CLOSED), np.append(high, GRIPPER_OPEN)
    rows = () if agents is None else (agents, 1)
    low, high = (
        np.tile(each, rows).astype(np.float32) if rows else each.astype(np.float32) for each in bounds
    )
    return spaces.Box(low, high, dtype=np.float32)


def space(seen: Observations, task: Task, agent: int | None = None) -> spaces.Dict:
    """The space of what one controller of all arms sees, or one agent."""
    rows = () if agent is not None and seen.state == "joints" else (len(task.agents),)
    cameras = camera_names(seen.cameras, 1 if agent is not None else len(task.agents))
    names = [name.replace("agent1", "local") for name in cameras] if agent is not None else cameras
    shown: dict[str, spaces.Space] = {}
    if seen.state != "none":
        shown |= {"qpos": _qpos_space(rows), "qvel": _unbounded((*rows, 9))}
    if seen.state == "full":
        shown |= {f"pose_{name}": _pose_space() for name in task.objects}
    size = (seen.height, seen.width)
    if seen.pictures:
        shown |= {f"rgb_{name}": spaces.Box(0, 255, (*size, 3), np.uint8) for name in names}
    if seen.depth:
        shown |= {f"depth_{name}": spaces.Box(0.0, FAR_M, size, np.float32) for name in names}
    if seen.segmentation:
        last = len(labels(task)) - 1
        shown |= {f"segmentation_{name}": spaces.Box(0, last, size, np.uint8) for name in names}
    if seen.language:
        count = len(task.description)
        text = spaces.Text(count, min_length=count, charset=frozenset(task.description))
        shown["language"] = text
    return spaces.Dict(shown)


def _qpos_space(rows: tuple[int, ...]) -> spaces.Box:
    low, high = limits_rad()
    bounds = np.append(low, [0.0, 0.0]) - OVERSHOOT, np.append(high, [FINGERS_OPEN_M] * 2) + OVERSHOOT
    low, high = (np.broadcast_to(each, (*rows, 9)).astype(np.float32) for each in bounds)
    return spaces.Box(low, high, dtype=np.float32)


def _pose_space() -> spaces.Box:
    high = np.array([np.inf] * 3 + [1.0] * 4, np.float32)
    return spaces.Box(-high, high, dtype=np.float32)


def _unbounded(shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def of_agent(seen: Observations, task: Task, agent: int) -> Callable[[ObservationDict], ObservationDict]:
    """Takes what one controller sees, and gives what this agent sees of it, in arrays of its own.

    What several agents see is copied for all but the last one, which gets it as it was taken. With state
    `full` the rows of joints are the agent's own first, then the others'.
    """
    order = np.array([agent - 1, *(other - 1 for other in task.agents if other != agent)])
    local = {f"{kind}_local": f"{kind}_agent{agent}" for kind in ("rgb", "depth", "segmentation")}
    joints = {"qpos", "qvel"} if seen.state == "joints" or len(task.agents) > 1 else set[str]()
    alone = {"language", *local} if agent < len(task.agents) else set(space(seen, task, agent))

    def rows(all_joints: NDArray[np.float32]) -> NDArray[np.float32]:
        return all_joints[agent - 1].copy() if seen.state == "joints" else all_joints.take(order, axis=0)

    parts: list[tuple[str, str, Callable[[NDArray], NDArray] | None]] = [
        (key, local.get(key, key), rows if key in joints else None if key in alone else np.ndarray.copy)
        for key in space(seen, task, agent)
    ]

    def take(whole: ObservationDict) -> ObservationDict:
        return {key: whole[name] if own is None else own(whole[name]) for key, name, own in parts}

    return take


def state_vector(scene: Scene) -> NDArray[np.float32]:
    """All joints, their velocities and the poses of all objects, one behind the other (N * 18 + K * 7,)."""
    poses = [position_and_quaternion(pose) for pose in scene.poses.values()]
    return np.concatenate([scene.qpos.ravel(), scene.qvel.ravel(), *poses]).astype(np.float32)


def state_space(task: Task) -> spaces.Box:
    """The space of `state_vector`."""
    return _unbounded((18 * len(task.agents) + 7 * len(task.objects),))
