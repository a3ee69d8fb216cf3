"""Simulator interface for the rest of the suite: arrays and frozen values, no types of ManiSkill."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, TypeVar

import numpy as np
import sapien
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.sim.contacts import Contacts
from rf_exp.sim.devices import Devices
from rf_exp.sim.environment import PHYSICS_HZ, TableEnv
from rf_exp.sim.objects import matrix_of
from rf_exp.sim.vulkan import require_rendering
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_HZ, GRIPPER_OPEN, CameraModel, Scene, joints_of

LARGEST_SEED = 2**32 - 1  # ManiSkill seeds legacy numpy generators
POSITION_TEXTURE = "PositionSegmentation"  # position in millimetres in camera axes, id of the body


Pair = TypeVar("Pair")


class LoadedScene:
    """SAPIEN's scene of one episode, and its step counter; the next reset builds all of it anew."""

    def __init__(self, env: TableEnv, *, renders: bool) -> None:
        self._joints = env.joint_interfaces()
        self.robots = [joints.arm for joints in self._joints]
        self.bodies = {name: actor._objs[0] for name, actor in env.actors.items()}
        hands = [robot.model.hand for robot in env.task.robots]
        self.clutter = {name: actor._objs[0] for name, actor in env.clutter.items()}
        self._contacts = Contacts(self.robots, hands, self.bodies, self.clutter)
        self._clutter_forces: dict[tuple[str, str], float] = {}  # largest in the last control step, N
        start = joints_of(env.start.qpos)
        holding_targets = np.hstack([start, np.full((len(start), 1), GRIPPER_OPEN)])  # (N, A)
        self.devices = Devices(env.start, holding_targets, tuple(env.task.cameras))
        self.command = self.devices.holding_command(holding_targets)
        self._env = env
        self.physics: Any = env.scene.px
        sensors: dict[str, Any] = env._sensors if renders else {}
        self._cameras = {name: sensor.camera._render_cameras[0] for name, sensor in sensors.items()}
        self._poses = _poses_of(self.bodies)
        self.steps = 0
        self._rendered_step, self._rendered = -1, set[str]()  # step of the last rendering, and its cameras

    def step(self, action: NDArray[np.float64]) -> dict[tuple[int, int], float]:
        """Apply a command (N, A) for one control step; returns (agent, agent) -> largest contact force, N."""
        self.command = action.copy()
        targets = self.devices.delayed_target(action)
        for joints, joint_targets in zip(self._joints, targets, strict=True):
            joints.command(joint_targets)
        arm_forces: dict[tuple[int, int], float] = {}
        self._clutter_forces = {}
        for _ in range(PHYSICS_HZ // CONTROL_HZ):
            self.physics.step()
            # A contact can end within a control step: keep the largest force over its physics steps.
            contacts, timestep_s = self.physics.get_contacts(), self.physics.timestep
            arm_forces = _largest_forces(arm_forces, self._contacts.arm_contacts(contacts, timestep_s))
            self._clutter_forces = _largest_forces(
                self._clutter_forces, self._contacts.clutter_contacts(contacts, timestep_s)
            )
        self.steps += 1
        return arm_forces

    def scene(self, arm_forces: Mapping[tuple[int, int], float]) -> Scene:
        """The measured scene; call once per control step, as speeds are displacements since the last call."""
        poses = _poses_of(self.bodies)
        moved_m = {name: np.linalg.norm(poses[name][:3, 3] - self._poses[name][:3, 3]) for name in poses}
        self._poses = poses
        held, pushes = self._contacts.finger_contacts(self.physics.get_contacts(), self.physics.timestep)
        scene = Scene(
            step=self.steps,
            qpos=np.stack([joints.qpos() for joints in self._joints]),
            qvel=np.stack([joints.qvel() for joints in self._joints]),
            poses=poses,
            # PhysX's own velocity of a held object is solver noise: 5 cm/s where nothing moves.
            speeds={name: float(distance) * CONTROL_HZ for name, distance in moved_m.items()},
            held=held,
            finger_forces=pushes,
            arm_contacts=tuple((a, b, force) for (a, b), force in sorted(arm_forces.items())),
            clutter=_poses_of(self.clutter),
            clutter_contacts=tuple(
                (mover, name, force) for (mover, name), force in sorted(self._clutter_forces.items())
            ),
        )
        return self.devices.measured_scene(scene)

    def place(self, qpos: NDArray[np.floating], poses: Mapping[str, NDArray]) -> None:
        """Set arms to measured joints (N, D) and objects to poses, and advance the step counter by one."""
        for joints, positions in zip(
            self._joints, self.devices.true_joints(np.asarray(qpos, float)), strict=True
        ):
            joints.place(positions)
        for name, pose in poses.items():
            body = self.bodies.get(name) or self.clutter[name]
            body.set_pose(sapien.Pose(pose[:3].tolist(), pose[3:].tolist()))
        self.steps += 1

    def textures(self, texture: str, cameras: Iterable[str] | None) -> dict[str, NDArray]:
        """Camera -> its texture at this step, rendered at most once; None: all cameras."""
        if self._rendered_step != self.steps:
            self._env.scene.sub_scenes[0].update_render()
            self._rendered_step, self._rendered = self.steps, set[str]()
        names = list(self._cameras if cameras is None else cameras)
        for name in names:
            if name not in self._cameras:
                raise unknown_choice("camera", name, self._cameras)
            if name not in self._rendered:
                self._cameras[name].take_picture()
                self._rendered.add(name)
        return {name: self._cameras[name].get_picture(texture) for name in names}

    def release(self) -> None:
        """Drop references to SAPIEN's bodies and cameras, so that the environment can be closed."""
        for container in (self.robots, self._joints, self.bodies, self.clutter, self._cameras):
            container.clear()


def _poses_of(bodies: Mapping[str, Any]) -> dict[str, Matrix]:
    return {name: matrix_of(body.pose) for name, body in bodies.items()}


def _largest_forces(before: Mapping[Pair, float], now: Mapping[Pair, float]) -> dict[Pair, float]:
    return {**before, **{pair: max(force, before.get(pair, 0.0)) for pair, force in now.items()}}


class Simulator:
    """Simulator of one task; implements `rf_exp.types.World`. A context manager.

    Physics at 100 Hz, control at 20 Hz. Arms track absolute joint targets and hold the last one.
    Raises StageError when `render` is set and there is no Vulkan device to render with.
    """

    def __init__(self, task: Task, *, width_px: int = 320, height_px: int = 240, render: bool = True) -> None:
        for name, value in (("width_px", width_px), ("height_px", height_px)):
            if value < 1:
                raise ArgumentError(f"{name}={value}: expected 1 pixel or more")
        if render:
            _require_rendering_once()
        self._size_px = (width_px, height_px)
        self._render = render
        self._env = TableEnv(task, self._size_px, _renderer()[0] if render else "none")
        self._loaded = self._load(0)

    @property
    def task(self) -> Task:
        """The task as varied for the present scene."""
        return self._env.task

    def reset(self, seed: int, copy: int = 0) -> Scene:
        """Begin an episode, a pure function of task, seed and `copy`; `copy` changes the pictures only."""
        self._loaded = self._load(seed, copy)
        return self._loaded.scene({})

    def place(self, qpos: NDArray[np.floating], poses: Mapping[str, NDArray[np.floating]]) -> None:
        """Set arms and objects to the state measured at the next control step; nothing is simulated.

        `qpos` (N, D) rad and metres; `poses` object -> (7,) position in m and quaternion w, x, y, z.
        """
        self._loaded.place(qpos, poses)

    def fling(self, name: str, velocity_m_s: Sequence[float]) -> None:
        """Give a movable object a velocity (3,) in the world frame, as if it had been thrown.

        Raises ArgumentError for an object that is fixed to the table.
        """
        body = self._loaded.bodies[name].find_component_by_type(sapien.physx.PhysxRigidDynamicComponent)
        if not isinstance(body, sapien.physx.PhysxRigidDynamicComponent):
            raise ArgumentError(f"{name!r} is fixed to the table and cannot be flung")
        body.set_linear_velocity(list(velocity_m_s))

    def _load(self, seed: int, copy: int = 0) -> LoadedScene:
        if not 0 <= seed <= LARGEST_SEED:
            raise ArgumentError(f"seed {seed}: expected a whole number from 0 to {LARGEST_SEED}")
        self._env.copy = copy
        self._env.reset(seed=int(seed))
        return LoadedScene(self._env, renders=self._render)

    def step(self, action: NDArray[np.float64]) -> Scene:
        """Apply (N, A) joint targets in rad and gripper commands in [-1, 1] for one control step."""
        action = np.asarray(action, dtype=float)
        expected = (len(self.task.robots), self.task.dof + 1)
        finite = np.isfinite(action).all()
        if action.shape != expected or not finite:
            raise ArgumentError(
                f"action of shape {action.shape}{'' if finite else ' with values that are not finite'}; "
                f"expected finite numbers of shape {expected}: joint targets in rad, gripper"
            )
        return self._loaded.scene(self._loaded.step(action))

    @property
    def command(self) -> NDArray[np.float64]:
        """(N, A) the last command; at the start the joint positions of the arms, grippers open."""
        return self._loaded.command.copy()

    @property
    def cameras(self) -> tuple[str, ...]:
        """Camera names: `global`, `agent1`, ...; empty without rendering."""
        return tuple(self.task.cameras) if self._render else ()

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        """Camera -> (H, W, 3) RGB of the present step: of `cameras`, or of all.

        Only these are rendered. Raises ArgumentError for a camera that does not exist.
        """
        camera_names, step = list(self.task.cameras), self._loaded.steps
        return {
            name: self._loaded.devices.degraded_picture(
                picture[..., :3].copy(), camera_names.index(name), step
            )
            for name, picture in self._textures("Color", cameras).items()
        }

    def segmentation(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.int32]]:
        """Camera -> (H, W) id of the body visible at each pixel, see `bodies`; 0 for none."""
        images = self._textures(POSITION_TEXTURE, cameras)
        return {name: image[..., 3].astype(np.int32) for name, image in images.items()}

    def depth(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.float32]]:
        """Camera -> (H, W) metres along the viewing direction, to the millimetre; 0 for no surface."""
        images = self._textures(POSITION_TEXTURE, cameras)
        return {name: np.float32(-0.001) * image[..., 2] for name, image in images.items()}

    def bodies(self) -> dict[str, tuple[int, ...]]:
        """Name -> ids in `segmentation`: objects, clutter, `table`, and `agent<k>` with all of its links."""
        numbers: dict[str, tuple[int, ...]] = {
            name: (actor._objs[0].per_scene_id,)
            for name, actor in self._env.scene.actors.items()
            if name in self._loaded.bodies or name in self._loaded.clutter or name == "table"
        }
        for agent, robot in zip(self.task.agents, self._loaded.robots, strict=True):
            numbers[f"agent{agent}"] = tuple(link.entity.per_scene_id for link in robot.links)
        return numbers

    def gripper(self, agent: int) -> tuple[int, ...]:
        """Ids in `segmentation` of the gripper links of an agent."""
        names = self.task.robots[agent - 1].model.gripper
        links = self._loaded.robots[agent - 1].links
        return tuple(link.entity.per_scene_id for link in links if link.name.endswith(tuple(names)))

    def camera_models(self) -> dict[str, CameraModel]:
        """Camera -> its model at the present step; eye-in-hand cameras move with their arm."""
        models = {}
        for name in self.cameras:
            spec = self.task.cameras[name]
            pose = self.task.parent_from_camera(name)
            if spec.mount == "wrist":
                hand = self._env.hand(int(name.removeprefix("agent")))._objs[0]
                pose = matrix_of(hand.entity_pose) @ pose
            models[name] = spec.model(pose, self._size_px)
        return models

    def _textures(self, texture: str, cameras: Iterable[str] | None = None) -> dict[str, NDArray]:
        if not self._render:
            raise ArgumentError("a simulator made with render=False draws no pictures; expected render=True")
        return self._loaded.textures(texture, cameras)

    def close(self) -> None:
        """Free the scene. The simulator cannot be used afterwards."""
        self._loaded.release()
        self._env.close()

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_require_rendering_once = cache(require_rendering)


@cache
def _renderer() -> tuple[str, sapien.render.RenderSystem]:
    """ManiSkill's name of the render backend, and a render system that is only kept alive.

    SAPIEN keeps its compiled shaders, which take seconds, as long as one render system exists.
    """
    with suppress(RuntimeError):  # where there is no such device
        device = sapien.Device("cuda")
        if device.can_render():
            return "gpu", sapien.render.RenderSystem(device)
    return "cpu", sapien.render.RenderSystem(sapien.Device("cpu"))
