"""ManiSkill environment: any number of arms on a table, set up by a task.

Physics runs at 100 Hz and control at 20 Hz for every task. The scene is rebuilt at every reset:
PhysX keeps contact caches and the order of its bodies, so only a new scene gives the same bytes
for the same seed, whatever ran before.
"""

import ctypes
import gc
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.agents.multi_agent import MultiAgent
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS, ShaderConfig
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.structs.actor import Actor
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from sapien import physx

from rf_exp.sim import objects
from rf_exp.sim.robots import JointInterface, uid_of
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_HZ, FINGERS

CONTACT_OFFSET_M = 0.005  # with ManiSkill's 0.02 a finger pad has contacts on one edge only: objects swing
PHYSICS_HZ = 100
NEAR_M, FAR_M = 0.01, 10.0
# SAPIEN's cameras look along x with y to the left and z up.
OPENCV_FROM_SAPIEN = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
SHADERS = Path(__file__).parent / "shaders"
BASE_SHADER_PACK = "minimal"  # ManiSkill's shader pack with the same textures
TEXTURE_FORMATS = {"Color": "r8g8b8a8unorm", "PositionSegmentation": "r16g16b16a16sint"}
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h of glibc
KEPT_FREE_BYTES, MAPPED_BYTES = 256 << 20, 32 << 20


def shader_config() -> ShaderConfig:
    """ManiSkill's configuration of our shaders, a folder of GLSL files that SAPIEN compiles.

    They compute only what our scenes need. The `minimal` pack inverts a matrix for every vertex, carries a
    tangent frame for normal maps, looks up an environment map and a reflection table for every pixel, and
    copies the picture in a separate pass. None of that is visible in a scene with colour textures only and
    without an environment map: the pictures are equal (tests/sim/test_shading.py), but for single pixels
    that round to the next of 255 shades. `python benchmarks/render.py` measures the cost of a picture.
    """
    return replace(PREBUILT_SHADER_CONFIGS[BASE_SHADER_PACK], shader_pack=str(SHADERS))


@cache
def keep_freed_memory() -> None:
    """Lets malloc keep freed memory for the next picture; glibc only.

    The software driver allocates and frees megabytes for every picture. Returned to the system each time,
    they cost 40 % of a picture's processor time in page faults.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, KEPT_FREE_BYTES)
        mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES)  # or blocks larger than 128 KiB would be mapped anew


@cache
def _freeze_modules() -> None:
    """Excludes imported modules from the garbage collection that ManiSkill runs at every reset."""
    gc.collect()
    gc.freeze()


def _restrict_excused_pairs(robot: physx.PhysxArticulation, agent: int) -> None:
    """Restricts the link pairs that an SRDF excuses from collision to links of the same arm.

    SAPIEN gives the two links of an excused pair a common bit in word 2 of their collision groups, and
    PhysX then ignores every two shapes with a common bit and the same number in word 3. Arms of one model
    get the same bits and SAPIEN leaves the number unset: without this, grippers of different arms would pass
    through one another.
    """
    for link in robot.links:
        for shape in link.collision_shapes:
            layer, collides_with, excused, _ = shape.get_collision_groups()
            shape.set_collision_groups([layer, collides_with, excused, agent])


class TableEnv(BaseEnv):
    """Robots, objects, cameras and light of one task. The seed fixes the whole initial state."""

    def __init__(self, task: Task, size_px: tuple[int, int], render_backend: str) -> None:
        _freeze_modules()
        self._nominal_task = self.task = task  # as configured, and varied for the scene of the seed
        self.copy = 0  # visual copy of the seed's scene that the next reset builds
        # Set at each reset; ManiSkill resets once in its constructor.
        self.start, self.actors, self.clutter = task.start(0), dict[str, Actor](), dict[str, Actor]()
        self._size_px = size_px
        super().__init__(
            obs_mode="none",
            reward_mode="none",
            control_mode="pd_joint_pos",
            robot_uids=tuple(uid_of(robot.model) for robot in task.robots),  # pyright: ignore[reportArgumentType]
            sim_backend="physx_cpu",
            render_backend=render_backend,
            reconfiguration_freq=1,
        )

    @property
    def _default_sim_config(self) -> SimConfig:
        scene = SceneConfig(contact_offset=CONTACT_OFFSET_M)
        return SimConfig(sim_freq=PHYSICS_HZ, control_freq=CONTROL_HZ, scene_config=scene)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        configs = []
        for name, camera in self.task.cameras.items():
            hand: Any = self.hand(int(name.removeprefix("agent"))) if camera.mount == "wrist" else None
            pose: Any = objects.sapien_pose(self.task.parent_from_camera(name) @ OPENCV_FROM_SAPIEN)
            frustum = *self._size_px, float(np.deg2rad(camera.fov_deg)), NEAR_M, FAR_M
            configs.append(CameraConfig(name, pose, *frustum, mount=hand, shader_config=shader_config()))
        return configs

    def _setup_sensors(self, options: dict) -> None:
        keep_freed_memory()
        for (
            texture,
            texture_format,
        ) in TEXTURE_FORMATS.items():  # other environments in this process may have changed it
            sapien.render.set_picture_format(texture, texture_format)
        super()._setup_sensors(options)

    @property
    def arms(self) -> list:
        """ManiSkill's agents, in the order of the task."""
        return self.agent.agents if isinstance(self.agent, MultiAgent) else [self.agent]

    def hand(self, agent: int):
        """ManiSkill's hand link of an agent."""
        return self.arms[agent - 1].robot.links_map[self.task.robots[agent - 1].model.hand.link]

    def joint_interfaces(self) -> list[JointInterface]:
        """The joints of each arm, in the order of the task."""
        arms, qpos_size = zip(self.task.robots, self.arms, strict=True), self.task.dof + FINGERS
        return [JointInterface(robot.model, arm.robot, qpos_size) for robot, arm in arms]

    def _load_agent(self, options: dict, *_: object, **__: object) -> None:
        seed = int(self._episode_seed[0])
        self.task = self._nominal_task.in_scene(seed, self.copy)
        self.start = self.task.start(seed, self.copy)
        bases: Any = [objects.sapien_pose(robot.world_from_base) for robot in self.task.robots]
        super()._load_agent(options, bases)
        for agent, arm in zip(self.task.agents, self.arms, strict=True):
            _restrict_excused_pairs(arm.robot._objs[0], agent)

    def _load_scene(self, options: dict) -> None:
        objects.build_table(self.scene, self.start.look)
        self.actors = {
            name: objects.build(
                self.scene,
                name,
                self.task.asset(name),
                self.start.poses[name],
                tint=self.start.tints[name],
                mass_kg=self.start.masses_kg[name],
            )
            for name in self.task.objects
        }
        for name, spec in self.task.objects.items():
            if (hinge := self.task.asset(name).hinge) is not None:
                objects.hang(self.actors[name], self.actors[spec.relative_to or ""], hinge, spec.nominal)
        self.clutter = {
            name: objects.build(self.scene, name, piece.asset, self.start.clutter[name])
            for name, piece in self.task.clutter.items()
        }

    def _load_lighting(self, options: dict) -> None:
        # No shadows: on software Vulkan they double the cost of a picture.
        light = self.start.lamps.brighter(self.start.light)
        self.scene.set_ambient_light([*light.ambient])
        for lamp in light.lamps:
            self.scene.add_directional_light([*lamp.direction], [*lamp.colour])

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict) -> None:
        for joints, qpos in zip(self.joint_interfaces(), self.start.qpos, strict=True):
            joints.place(qpos)
            joints.drive(qpos)  # else the arm would move towards zero
