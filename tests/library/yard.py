"""A third-party scene: three Pandas, one raised and tilted, among bodies of every shape."""

from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import sapien
import trimesh
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.building.ground import build_ground
from scipy.spatial.transform import Rotation

from rf_exp.robots import DEFAULT

BASES = {  # position in m, yaw and pitch in degrees
    "south": ((0.0, -0.7, 0.0), 90.0, 0.0),
    "north": ((0.0, 0.7, 0.0), -90.0, 0.0),
    "raised": ((-0.8, 0.0, 0.15), 0.0, 10.0),
}
# Position of the body's frame in m, yaw in degrees.
BODIES: dict[str, tuple[tuple[float, float, float], float]] = {
    "box": ((-0.25, -0.05, 0.03), 30.0),
    "on top": ((-0.25, -0.05, 0.09), 0.0),
    "ball": ((-0.3, 0.2, 0.02), 0.0),
    "can": ((0.1, -0.25, 0.05), 0.0),
    "pill": ((0.1, 0.25, 0.02), 45.0),
    "wedge": ((0.25, 0.1, 0.0), 0.0),
    "wall": ((0.4, 0.0, 0.0), 0.0),
    "Mark-1": ((0.1, 0.0, 0.0), 0.0),
}
WEDGE_M = np.array([[0, 0, 0], [0.06, 0, 0], [0, 0.03, 0], [0.06, 0.03, 0], [0, 0, 0.04], [0, 0.03, 0.04]])


class ThreeArmEnv(BaseEnv):
    """A ManiSkill environment with the poses of `BODIES` for every seed."""

    def __init__(self, **options: Any) -> None:
        super().__init__(
            robot_uids=("panda",) * len(BASES),  # pyright: ignore[reportArgumentType]
            obs_mode="none",
            reward_mode="none",
            render_backend="none",
            **{"control_mode": "pd_joint_pos", **options},
        )

    def _load_agent(self, options: dict, *_: object, **__: object) -> None:
        poses: Any = [_pose(p, yaw, pitch) for p, yaw, pitch in BASES.values()]
        super()._load_agent(options, poses)

    def _load_scene(self, options: dict) -> None:
        build_ground(self.scene)
        upright = sapien.Pose(q=[np.sqrt(0.5), 0, np.sqrt(0.5), 0])  # cylinders of PhysX are along x
        self._build("box", lambda actor: actor.add_box_collision(half_size=(0.04, 0.02, 0.03)))
        self._build("on top", lambda actor: actor.add_box_collision(half_size=(0.02, 0.02, 0.03)))
        self._build("ball", lambda actor: actor.add_sphere_collision(radius=0.02))
        self._build("can", lambda actor: actor.add_cylinder_collision(upright, radius=0.03, half_length=0.05))
        self._build("pill", lambda actor: actor.add_capsule_collision(radius=0.02, half_length=0.03))
        self._build("wedge", lambda actor: actor.add_convex_collision_from_file(_file(WEDGE_M)))
        wall = lambda actor: actor.add_box_collision(sapien.Pose([0, 0, 0.1]), (0.01, 0.1, 0.1))  # noqa: E731
        self._build("wall", wall, kind="static")
        self._build("Mark-1", lambda actor: None, kind="kinematic")

    def _build(self, name: str, shape: Callable[[Any], object], kind: str = "dynamic") -> None:
        builder = self.scene.create_actor_builder()
        builder.set_physx_body_type(kind)  # pyright: ignore[reportArgumentType]
        shape(builder)
        builder.set_initial_pose(_pose(*BODIES[name]))
        builder.build(name)

    def _initialize_episode(self, env_idx: Any, options: dict) -> None:
        for arm in self.agent.agents:  # pyright: ignore[reportAttributeAccessIssue]
            arm.reset(np.array([*DEFAULT.rest_rad, 0.04, 0.04]))


def _pose(position_m: tuple[float, ...], yaw_deg: float, pitch_deg: float = 0.0) -> sapien.Pose:
    rotation = Rotation.from_euler("zy", [yaw_deg, pitch_deg], degrees=True)
    return sapien.Pose(list(position_m), rotation.as_quat(scalar_first=True).tolist())


def _file(corners: np.ndarray) -> str:
    """A file with the convex hull of corners (K, 3), since SAPIEN reads meshes only from files."""
    path = Path(mkdtemp()) / "mesh.stl"
    trimesh.convex.convex_hull(corners).export(path)
    return str(path)
