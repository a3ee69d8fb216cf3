"""One episode's scene as SAPIEN has loaded it, and how far it is."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
import sapien
from numpy.typing import NDArray

from rf_exp.errors import choices
from rf_exp.sim.contacts import Contacts
from rf_exp.sim.devices import Devices
from rf_exp.sim.environment import PHYSICS_HZ, TableEnv
from rf_exp.sim.objects import matrix_of
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_HZ, GRIPPER_OPEN, Scene, joints_of

Pair = TypeVar("Pair")


class LoadedScene:
    """What a reset of the environment has built; the next reset builds all of it anew."""

    def __init__(self, env: TableEnv, *, draws: bool) -> None:
        self.robots = [arm.robot._objs[0] for arm in env.arms]
        self._joints = [robot.active_joints for robot in self.robots]
        self.bodies = {name: actor._objs[0] for name, actor in env.actors.items()}
        self._rows = env.rows()
        hands = [robot.model.hand for robot in env.task.robots]
        self.clutter = {name: actor._objs[0] for name, actor in env.clutter.items()}
        self._contacts = Contacts(self.robots, hands, self.bodies, self.clutter)
        self._knocks: dict[tuple[str, str], float] = {}  # with clutter, in the last control step: N
        start = joints_of(env.start.qpos)
        held = np.hstack([start, np.full((len(start), 1), GRIPPER_OPEN)])  # (N, A)
        self.devices = Devices(env.start, held)
        self.command = self.devices.command_of(held)
        self._env = env
        self.physics: Any = env.scene.px
        sensors: dict[str, Any] = env._sensors if draws else {}
        self._cameras = {name: sensor.camera._render_cameras[0] for name, sensor in sensors.items()}
        self._poses = _measured(self.bodies)
        self.steps = 0
        self._drawn_at, self._drawn = -1, set[str]()  # the step of the last pictures, and their cameras

    def step(self, action: NDArray[np.float64]) -> dict[tuple[int, int], float]:
        """Apply (N, A) joint targets and gripper commands for one control step.

        Returns (agent, agent) -> the hardest push between two arms, in N.
        """
        self.command = action.copy()
        told = self.devices.carried_out(action)
        for joints, rows, command in zip(self._joints, self._rows, told, strict=True):
            for joint, value in zip(joints, rows.targets(command).tolist(), strict=True):
                joint.set_drive_target(value)
        pressed: dict[tuple[int, int], float] = {}
        self._knocks = {}
        for _ in range(PHYSICS_HZ // CONTROL_HZ):
            self.physics.step()
            # A knock can be over within one control step: keep the hardest push of the physics steps.
            contacts, timestep_s = self.physics.get_contacts(), self.physics.timestep
            pressed = _hardest(pressed, self._contacts.between_arms(contacts, timestep_s))
            self._knocks = _hardest(self._knocks, self._contacts.with_clutter(contacts, timestep_s))
        self.steps += 1
        return pressed

    def scene(self, pressed: Mapping[tuple[int, int], float]) -> Scene:
        """As measured now; once a control step, since speeds are what has moved since the last time."""
        poses = _measured(self.bodies)
        moved_m = {name: np.linalg.norm(poses[name][:3, 3] - self._poses[name][:3, 3]) for name in poses}
        self._poses = poses
        held, pushes = self._contacts.of_fingers(self.physics.get_contacts(), self.physics.timestep)
        arms = [*zip(self._rows, self.robots, strict=True)]
        scene = Scene(
            step=self.steps,
            qpos=np.stack([rows.qpos(robot.qpos) for rows, robot in arms]),
            qvel=np.stack([rows.qvel(robot.qvel) for rows, robot in arms]),
            poses=poses,
            # PhysX's own velocity of what is held is its solver's noise: 5 cm/s where nothing moves.
            speeds={name: float(distance) * CONTROL_HZ for name, distance in moved_m.items()},
            held=held,
            finger_forces=pushes,
            arm_contacts=tuple((a, b, force) for (a, b), force in sorted(pressed.items())),
            clutter=_measured(self.clutter),
            clutter_contacts=tuple((who, name, force) for (who, name), force in sorted(self._knocks.items())),
        )
        return self.devices.measured(scene)

    def place(self, qpos: NDArray[np.floating], poses: Mapping[str, NDArray]) -> None:
        """Arms by their measured joints (N, D) and things by their poses, at the next control step."""
        rows_of_arms = self.devices.true(np.asarray(qpos, float))
        for robot, rows, row in zip(self.robots, self._rows, rows_of_arms, strict=True):
            robot.set_qpos(rows.active(row).astype(np.float32))
        for name, pose in poses.items():
            self.bodies[name].set_pose(sapien.Pose(pose[:3].tolist(), pose[3:].tolist()))
        self.steps += 1

    def drawn(self, texture: str, cameras: Iterable[str] | None) -> dict[str, NDArray]:
        """Camera -> its texture at this step, drawn once however often it is asked for; None: of all."""
        if self._drawn_at != self.steps:
            self._env.scene.sub_scenes[0].update_render()
            self._drawn_at, self._drawn = self.steps, set[str]()
        wanted = list(self._cameras if cameras is None else cameras)
        for name in wanted:
            if name not in self._cameras:
                raise choices("camera", name, self._cameras)
            if name not in self._drawn:
                self._cameras[name].take_picture()
                self._drawn.add(name)
        return {name: self._cameras[name].get_picture(texture) for name in wanted}

    def release(self) -> None:
        """Let go of SAPIEN's bodies and cameras, so that the environment can be closed."""
        for kept in (self.robots, self._joints, self.bodies, self.clutter, self._cameras):
            kept.clear()


def _measured(bodies: Mapping[str, Any]) -> dict[str, Matrix]:
    """Where bodies are, world frame."""
    return {name: matrix_of(body.pose) for name, body in bodies.items()}


def _hardest(before: Mapping[Pair, float], now: Mapping[Pair, float]) -> dict[Pair, float]:
    """Of each pair the harder push."""
    found = dict(before)
    for pair, force in now.items():
        found[pair] = max(force, found.get(pair, 0.0))
    return found
