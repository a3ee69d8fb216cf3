"""Teams of arms, scenes and rest-to-rest trajectories for tests of constraints."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.geometry import PlanningScene
from rf_exp.robots import DEFAULT, Arm
from rf_exp.tasks import CameraSpec, Randomisation, RobotSpec, Task, default_of, load_task
from rf_exp.transforms import Matrix, interpolate, inverse, transform
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, Scene, Segment, Subgoal, Trajectory

CONF = Path(__file__).parents[2] / "conf" / "task"
BASES = ((0.0, -0.5, 90.0), (0.0, 0.5, -90.0), (0.6, 0.0, 180.0), (-0.6, 0.0, 0.0))
REST = np.array(DEFAULT.rest_rad)
# TCP 0.3 m above the middle of the table between two facing arms: clear of the other arm at rest, but not
# if both arms reach.
REACHING = np.array([0.2, 0.34, -0.22, -1.69, 0.08, 2.02, 2.3])


def team(count: int) -> Task:
    """A task with `count` arms round an empty table, near enough to collide."""
    cameras = {"global": CameraSpec(), **{f"agent{k + 1}": CameraSpec() for k in range(count)}}
    robots = tuple(RobotSpec(*base) for base in BASES[:count])
    randomisation = Randomisation(**default_of("randomisation"))
    return Task("lift_barrier", "Team", "", "", robots, {}, cameras, {}, randomisation)


def real(name: str) -> Task:
    """The task of conf/task."""
    return load_task(name, OmegaConf.to_container(OmegaConf.load(CONF / f"{name}.yaml"))[name])  # pyright: ignore


def scene_of(task: Task, seed: int = 0, **changes) -> Scene:
    """The start of an episode as a measured scene."""
    start = task.start(seed)
    values = {
        "step": 0,
        "qpos": start.qpos,
        "qvel": np.zeros_like(start.qpos),
        "poses": start.poses,
        "speeds": dict.fromkeys(start.poses, 0.0),
        "held": (None,) * len(start.qpos),
    }
    return Scene(**{**values, **changes})


def random_qpos(rng: np.random.Generator, count: int, spread_rad: float = 0.6) -> NDArray[np.float64]:
    """Random joint positions (count, 7) of an arm that leans over the table."""
    return REST + rng.normal(0.0, spread_rad, (count, 7)) * np.array([1, 1, 0.5, 1, 0.5, 1, 1])


def motion(start: NDArray[np.float64], goal: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
    """Rest-to-rest motion (steps, 7) without the start."""
    fraction = (1 - np.cos(np.pi * np.arange(1, steps + 1) / steps)) / 2
    return start + fraction[:, None] * (goal - start)


def walk(
    agent: int, keys: Sequence[NDArray[np.float64]], steps: int | Sequence[int] = 10, **segment
) -> Trajectory:
    """A trajectory through joint positions (7,), with one segment and subgoal between each two."""
    counts = [steps] * (len(keys) - 1) if isinstance(steps, int) else steps
    segments = tuple(
        Segment(
            agent,
            Subgoal(agent, "carry", f"thing{k}"),
            "move",
            motion(keys[k], keys[k + 1], count),
            np.full(count, GRIPPER_OPEN),
            **segment,
        )
        for k, count in enumerate(counts)
    )
    return Trajectory(agent, keys[0], GRIPPER_OPEN, segments)


def idle(agent: int, qpos: NDArray[np.float64] = REST) -> Trajectory:
    return Trajectory(agent, qpos, GRIPPER_OPEN, ())


class Hand:
    """Builder of trajectories of one agent from straight lines of its TCP, without checks."""

    def __init__(self, task: Task, scene: Scene, agent: int) -> None:
        self.task, self.scene, self.agent = task, scene, agent
        self.arm = Arm(DEFAULT, task.robots[agent - 1].world_from_base)
        self.start = scene.qpos[agent - 1, :7]
        self.qpos = self.start
        self.segments: list[Segment] = []
        self.held: tuple[str, Matrix] | None = None
        self.gripper = GRIPPER_OPEN

    def to(
        self, goal: Matrix, steps: int, subgoal: Subgoal, primitive: str, touches=(), joined=None
    ) -> "Hand":
        """Adds a straight motion of the TCP to a pose."""
        start = self.arm.tcp(self.qpos)
        joints = []
        for fraction in (1 - np.cos(np.pi * np.arange(1, steps + 1) / steps)) / 2:
            solved = self.arm.solve(interpolate(start, goal, float(fraction)), self.qpos)
            assert solved is not None, f"agent {self.agent} does not reach {goal[:3, 3]}"
            self.qpos = solved
            joints.append(solved)
        return self._add(np.array(joints), subgoal, primitive, touches, joined)

    def fingers(self, command: float, subgoal: Subgoal, primitive: str, touches=()) -> "Hand":
        self.gripper = command
        return self._add(np.tile(self.qpos, (8, 1)), subgoal, primitive, touches, None)

    def grasp(self, name: str, point: str, *, shift_m=(0.0, 0.0, 0.0), steps: int = 20) -> "Hand":
        """Adds a grasp: above the object, down to its point shifted by `shift_m`, closing the fingers."""
        goal = self.goal(name, point)
        goal[:3, 3] += shift_m
        subgoal = Subgoal(self.agent, "grasp", name, point)
        self.to(goal @ transform((0, 0, -0.1)), steps, subgoal, "move")
        self.to(goal, 10, subgoal, "approach", {name})
        self.fingers(GRIPPER_CLOSED, subgoal, "close", {name})
        self.hold(name)
        return self

    def hold(self, name: str) -> "Hand":
        self.gripper = GRIPPER_CLOSED
        self.held = name, inverse(self.arm.tcp(self.qpos)) @ self.scene.poses[name]
        return self

    def lift(self, height_m: float, steps: int = 20, joined: str | None = None, touches=()) -> "Hand":
        assert self.held is not None
        goal = transform((0, 0, height_m)) @ self.arm.tcp(self.qpos)
        subgoal = Subgoal(self.agent, "lift", self.held[0], height_m=height_m)
        return self.to(goal, steps, subgoal, "lift", {self.held[0], *touches}, joined)

    def goal(self, name: str, point: str) -> Matrix:
        """World pose of the TCP at an interaction point; the nearer of two orientations half a turn apart."""
        pose = self.scene.poses[name] @ self.task.asset(name).points[point].object_from_tcp
        turned = pose @ np.diag([-1.0, -1.0, 1.0, 1.0])
        current = self.arm.tcp(self.qpos)
        return max(pose, turned, key=lambda each: float(np.trace(each[:3, :3].T @ current[:3, :3])))

    @property
    def trajectory(self) -> Trajectory:
        held = self.scene.held[self.agent - 1] is not None
        return Trajectory(
            self.agent, self.start, GRIPPER_CLOSED if held else GRIPPER_OPEN, tuple(self.segments)
        )

    def _add(self, joints, subgoal: Subgoal, primitive: str, touches, joined) -> "Hand":
        name, pose = self.held or (None, None)
        grip = np.full(len(joints), self.gripper)
        self.segments.append(
            Segment(self.agent, subgoal, primitive, joints, grip, name, pose, frozenset(touches), joined)
        )
        return self


def arms(task: Task, rng: np.random.Generator, positions: int):
    """Swept bodies of two arms along random joint paths."""
    planning_scene = PlanningScene(task, scene_of(task))
    return tuple(planning_scene.arm(agent, random_qpos(rng, positions)) for agent in (1, 2))
