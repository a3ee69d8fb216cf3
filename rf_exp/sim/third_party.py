"""Adapter for third-party ManiSkill environments: reads and drives one as a world of arms and bodies.

Bodies have PhysX's collision shapes as convex meshes.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from mani_skill.agents.controllers import PDJointPosController, PDJointPosMimicController
from mani_skill.agents.multi_agent import MultiAgent
from mani_skill.envs.sapien_env import BaseEnv
from numpy.typing import NDArray
from sapien import physx
from scipy.spatial.transform import Rotation

from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.robots import Robot, known_robots
from rf_exp.sim.contacts import Contacts
from rf_exp.sim.objects import matrix_of
from rf_exp.sim.robots import JointInterface
from rf_exp.tasks import assets
from rf_exp.transforms import Matrix, apply, inverse, transform
from rf_exp.types import CONTROL_HZ, FINGERS, Scene

CONTROL_MODE = "pd_joint_pos"
POSE_TOLERANCE_M = 1e-3  # tolerance between the pose of a link and the robot's model
TABLE_HEIGHT_M = 1e-3  # bodies that are nowhere higher are part of the table
ROUND_SECTIONS = 24  # of a cylinder; round shapes are enclosed by polyhedra
ALONG_X = transform(rotation=Rotation.from_euler("y", np.pi / 2))  # from trimesh's axis, z, to PhysX's


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body of the scene."""

    solids: tuple[trimesh.Trimesh, ...]  # convex, in the frame of the body; empty: no collision shapes
    movable: bool
    mass_kg: float


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of the scene."""

    name: str  # ManiSkill's
    robot: Robot
    world_from_base: Matrix
    rest_rad: tuple[float, ...]  # (dof,) joints when the environment was read
    mounted: tuple[trimesh.Trimesh, ...]  # convex, of links fixed to the hand, in its frame


@dataclass(frozen=True)
class StepResult:
    """Result of a control step of the environment."""

    scene: Scene
    terminated: bool
    truncated: bool
    info: Mapping[str, Any]  # unchanged


class ThirdPartyEnvironment:
    """Third-party ManiSkill environment, in the state in which it is read.

    Names are ManiSkill's, with `_` for every character that is no letter, digit or `_`. Bodies nowhere higher
    than `TABLE_HEIGHT_M` form the table and are left out of `bodies`. Poses are those of the body frames.
    Raises ArgumentError for an environment that cannot be read, with what is expected instead.
    """

    def __init__(self, env: Any, ignore: Collection[str] = ()) -> None:
        """`ignore`: names of bodies to leave out. Raises ArgumentError for an unknown name."""
        self._env, self._base = env, _supported(getattr(env, "unwrapped", env))
        agent: Any = self._base.agent
        self._single = not isinstance(agent, MultiAgent)
        arms: dict[str, Any] = {agent.uid: agent} if self._single else dict(agent.agents_dict)
        models = {name: _matching_robot(name, arm) for name, arm in arms.items()}
        self._action_functions = {
            name: _action_function(name, arm, models[name]) for name, arm in arms.items()
        }
        size = max(model.dof for model in models.values()) + FINGERS
        joints = {name: JointInterface(models[name], arm.robot, size) for name, arm in arms.items()}
        self._joints = [*joints.values()]
        self.arms = tuple(_read_arm(name, arm, models[name], joints[name]) for name, arm in arms.items())
        components = _rigid_bodies(self._base, arms)
        for name in ignore:
            if name not in components:
                raise unknown_choice("body to ignore", name, components)
        self._bodies = {name: body for name, body in components.items() if name not in ignore}
        bodies: dict[str, Body] = {}
        for name, body in self._bodies.items():
            rigid_body: Any = body
            dynamic = isinstance(rigid_body, physx.PhysxRigidDynamicComponent) and not rigid_body.kinematic
            bodies[name] = Body(solids(rigid_body, name), dynamic, float(rigid_body.mass) if dynamic else 0.0)
        self.table = tuple(name for name, body in bodies.items() if self._is_table(name, body))
        for name in self.table:
            del self._bodies[name], bodies[name]
        self.bodies: Mapping[str, Body] = bodies
        hands = [model.hand for model in models.values()]
        entities = {name: body.entity for name, body in self._bodies.items()}
        self._contacts = Contacts([arm_joints.arm for arm_joints in self._joints], hands, entities)
        self._seed, self._read_step = self._episode_key(), self._elapsed_steps()
        self._poses, self._measured_step = self.poses(), self._read_step
        self._speeds = dict.fromkeys(self._poses, 0.0)

    def poses(self) -> dict[str, Matrix]:
        """Name -> world_from_body (4, 4), now."""
        return {name: matrix_of(body.entity_pose) for name, body in self._bodies.items()}

    def scene(self) -> Scene:
        """The scene measured now, with the contacts of the last physics step.

        Raises ArgumentError where the environment has been reset since it was read.
        """
        step = self._elapsed_steps()
        if self._episode_key() != self._seed or step < self._read_step:
            raise ArgumentError("the environment was reset after its scene was read; read it again")
        poses, passed_s = self.poses(), (step - self._measured_step) / CONTROL_HZ
        if passed_s:
            moved_m = {name: np.linalg.norm((poses[name] - self._poses[name])[:3, 3]) for name in poses}
            self._speeds = {name: float(metres) / passed_s for name, metres in moved_m.items()}
            self._poses, self._measured_step = poses, step
        physics: Any = self._base.scene.px
        # After a reset, PhysX lists the contacts of the last episode until the first step.
        contacts = physics.get_contacts() if step else []
        held, pushes = self._contacts.finger_contacts(contacts, physics.timestep)
        arm_forces = self._contacts.arm_contacts(contacts, physics.timestep)
        return Scene(
            step=step,
            qpos=np.stack([joints.qpos() for joints in self._joints]),
            qvel=np.stack([joints.qvel() for joints in self._joints]),
            poses=poses,
            speeds=dict(self._speeds),
            held=held,
            finger_forces=pushes,
            arm_contacts=tuple((a, b, force) for (a, b), force in sorted(arm_forces.items())),
        )

    def step(self, command: NDArray[np.float64]) -> StepResult:
        """Run one control step with (N, A) joint targets in rad and grippers from -1 closed to 1 open."""
        rows_by_arm = zip(self._action_functions.items(), command, strict=True)
        actions = {name: action_of(row) for (name, action_of), row in rows_by_arm}
        action: Any = next(iter(actions.values())) if self._single else actions
        _, _, terminated, truncated, info = self._env.step(action)
        return StepResult(self.scene(), bool(terminated), bool(truncated), info)

    def _is_table(self, name: str, body: Body) -> bool:
        """Whether a body is nowhere higher than `TABLE_HEIGHT_M`. Of a plane only its height counts.

        Raises ArgumentError for a higher plane.
        """
        pose = matrix_of(self._bodies[name].entity_pose)
        planes = [
            float((pose @ matrix_of(shape.local_pose))[2, 3])
            for shape in self._bodies[name].collision_shapes
            if isinstance(shape, physx.PhysxCollisionShapePlane)
        ]
        if planes and max(planes) > TABLE_HEIGHT_M:
            raise ArgumentError(f"{name} is a plane at z = {max(planes):g} m; expected at most 0")
        tops = [float(apply(pose, np.asarray(solid.vertices))[:, 2].max()) for solid in body.solids]
        return bool(planes or tops) and max([*planes, *tops]) <= TABLE_HEIGHT_M

    def _elapsed_steps(self) -> int:
        return int(self._base.elapsed_steps[0])

    def _episode_key(self) -> tuple[int, int]:
        return int(self._base._episode_seed[0]), id(self._base.scene)


def _supported(base: Any) -> BaseEnv:
    if not isinstance(base, BaseEnv):
        raise ArgumentError(
            f"{type(base).__name__} is no ManiSkill environment; expected gymnasium.make's of one"
        )
    if base.num_envs != 1:
        raise ArgumentError(f"the environment is {base.num_envs} parallel ones; expected num_envs=1")
    if base.gpu_sim_enabled:
        raise ArgumentError("the environment simulates on a GPU; expected sim_backend='physx_cpu'")
    if base.control_freq != CONTROL_HZ:
        raise ArgumentError(
            f"the environment is controlled at {base.control_freq} Hz; expected {CONTROL_HZ}: "
            f"gymnasium.make(..., sim_config={{'control_freq': {CONTROL_HZ}}})"
        )
    if base.agent is None:
        raise ArgumentError("the environment has no robot; expected one or more")
    return base


def _matching_robot(name: str, arm: Any) -> Robot:
    """The known robot with the joints of an arm. Raises ArgumentError where there is none."""
    joints = [joint.name for joint in arm.robot.active_joints]
    for robot in known_robots():
        if sorted(joints) == sorted(robot.active_joints):
            return robot
    possible = "; ".join(f"{robot.title}: {', '.join(robot.active_joints)}" for robot in known_robots())
    raise ArgumentError(f"{name} has the joints {', '.join(joints)}; expected a {possible}")


def _action_function(
    name: str, arm: Any, robot: Robot
) -> Callable[[NDArray[np.float64]], NDArray[np.float32]]:
    """Returns a function from an arm's row of a command to its action in the environment.

    Raises ArgumentError for an arm that does not take absolute joint targets and a gripper width.
    """
    controllers = getattr(arm.controller, "controllers", {})
    joint, gripper = controllers.get("arm"), controllers.get("gripper")
    config = joint.config if isinstance(joint, PDJointPosController) else None
    absolute = config is not None and not (config.use_delta or config.normalize_action)
    if not absolute or not isinstance(gripper, PDJointPosMimicController) or gripper.config.use_delta:
        raise ArgumentError(
            f"{name} has the control mode {arm.control_mode!r}; expected absolute joint targets in rad: "
            f"gymnasium.make(..., control_mode={CONTROL_MODE!r})"
        )
    lowest, highest = gripper._get_joint_limits()[0].tolist()
    finger = robot.hand.fingers[0]
    closed, opened = finger.position(0.0), finger.position(robot.hand.open_m)
    if abs(highest - max(closed, opened)) > POSE_TOLERANCE_M or lowest > min(closed, opened):
        raise ArgumentError(
            f"the fingers of {name} are commanded to {lowest:g} to {highest:g} m; expected at most "
            f"{min(closed, opened):g} to {max(closed, opened):g} m"
        )
    space: Any = gripper.single_action_space
    spans = {part: slice(*span) for part, span in arm.controller.action_mapping.items()}
    size = int(arm.controller.single_action_space.shape[0])
    ends = float(space.low[0]), float(space.high[0])
    closed_action, open_action = ends if closed < opened else ends[::-1]

    def action(row: NDArray[np.float64]) -> NDArray[np.float32]:
        values = np.zeros(size, np.float32)
        values[spans["arm"]] = row[: robot.dof]
        opening = (np.clip(row[-1], -1.0, 1.0) + 1) / 2
        values[spans["gripper"]] = closed_action + opening * (open_action - closed_action)
        return values

    return action


def _read_arm(name: str, arm: Any, model: Robot, joints: JointInterface) -> Arm:
    """Reads an arm. Raises ArgumentError where its links do not match the robot's model."""
    links = {link: body._objs[0] for link, body in arm.robot.links_map.items()}
    if missing := [link for link in model.links if link not in links]:
        raise ArgumentError(f"{name} is no {model.title}: it has no link {', '.join(missing)}")
    world_from_base, qpos = matrix_of(links[model.links[0]].entity_pose), joints.qpos()
    for link, base_from_link in zip(model.links, model.link_poses(qpos), strict=True):
        error_m = float(np.abs(world_from_base @ base_from_link - matrix_of(links[link].entity_pose)).max())
        if error_m > POSE_TOLERANCE_M:
            raise ArgumentError(
                f"{name} is no {model.title}: its {link} is {error_m:.4f} m from where that has it"
            )
    hand = links[model.hand.link]
    hand_from_world = inverse(matrix_of(hand.entity_pose))
    mounted = []
    for link, body in links.items():
        if link in model.links or not body.collision_shapes:
            continue
        if not _is_fixed_to_hand(body, hand):
            raise ArgumentError(
                f"{name} has a link {link} that is not fixed to its hand, as planners expect it"
            )
        hand_from_link = hand_from_world @ matrix_of(body.entity_pose)
        mounted += [solid.apply_transform(hand_from_link) for solid in solids(body, f"{link} of {name}")]
    return Arm(name, model, world_from_base, tuple(qpos[: model.dof].tolist()), tuple(mounted))


def _is_fixed_to_hand(link: Any, hand: Any) -> bool:
    while link is not None and link != hand and link.joint.dof == 0:
        link = link.parent
    return link == hand


def _rigid_bodies(base: BaseEnv, arms: Mapping[str, Any]) -> dict[str, physx.PhysxRigidBaseComponent]:
    """The rigid bodies by name: actors, and the links of articulations other than the arms."""
    component_type, actors = physx.PhysxRigidBaseComponent, base.scene.actors.items()
    bodies: dict[str, Any] = {
        name: actor._objs[0].find_component_by_type(component_type) for name, actor in actors
    }
    robots = [arm.robot for arm in arms.values()]
    for name, articulation in base.scene.articulations.items():
        if not any(articulation is robot for robot in robots):
            bodies |= {
                f"{name}_{link}": link_body._objs[0] for link, link_body in articulation.links_map.items()
            }
    return {re.sub(r"\W", "_", name): body for name, body in bodies.items() if body is not None}


def solids(body: physx.PhysxRigidBaseComponent, body_name: str) -> tuple[trimesh.Trimesh, ...]:
    """Convex meshes, in the body's frame and metres, that together enclose its collision shapes.

    Triangle meshes are decomposed, which takes seconds. Planes have no extent and are left out. Raises
    ArgumentError, with `body_name` as its name, for a mesh that is not closed and for an unknown type of
    shape.
    """
    meshes = []
    for shape in body.collision_shapes:
        if isinstance(shape, physx.PhysxCollisionShapePlane):
            continue
        body_from_shape = matrix_of(shape.local_pose)
        meshes += [mesh.apply_transform(body_from_shape) for mesh in _meshes(shape, body_name)]
    return tuple(meshes)


def _meshes(shape: physx.PhysxCollisionShape, body_name: str) -> Iterator[trimesh.Trimesh]:
    """Convex meshes in the frame of the shape."""
    if isinstance(shape, physx.PhysxCollisionShapeBox):
        yield trimesh.creation.box(2 * np.asarray(shape.half_size, float))
    elif isinstance(shape, physx.PhysxCollisionShapeSphere):
        yield _enclosing_ball(shape.radius)
    elif isinstance(shape, physx.PhysxCollisionShapeCylinder):
        outer_radius_m = shape.radius / np.cos(np.pi / ROUND_SECTIONS)
        yield trimesh.creation.cylinder(
            outer_radius_m, 2 * shape.half_length, ROUND_SECTIONS, transform=ALONG_X
        )
    elif isinstance(shape, physx.PhysxCollisionShapeCapsule):
        corners = _enclosing_ball(shape.radius).vertices
        ends = [corners + np.array((side * shape.half_length, 0.0, 0.0)) for side in (-1, 1)]
        yield trimesh.convex.convex_hull(np.concatenate(ends))
    elif isinstance(shape, physx.PhysxCollisionShapeConvexMesh):
        yield trimesh.convex.convex_hull(np.asarray(shape.vertices, float) * shape.scale)
    elif isinstance(shape, physx.PhysxCollisionShapeTriangleMesh):
        yield from _decomposed(shape, body_name)
    else:
        raise ArgumentError(
            f"{body_name} has a collision shape of type {type(shape).__name__}, which is not read"
        )


def _enclosing_ball(radius_m: float) -> trimesh.Trimesh:
    """A polyhedron around a sphere."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    inner = float(np.einsum("fi,fi->f", ball.triangles_center, ball.face_normals).min())
    return ball.apply_scale(radius_m / inner)


def _decomposed(shape: physx.PhysxCollisionShapeTriangleMesh, body_name: str) -> Iterator[trimesh.Trimesh]:
    mesh = trimesh.Trimesh(np.asarray(shape.vertices, float) * shape.scale, shape.triangles, process=True)
    for shell in mesh.split(only_watertight=False, repair=False):
        shell.fix_normals()
        if not shell.is_watertight or shell.volume <= 0:
            raise ArgumentError(
                f"{body_name} has a triangle mesh that is not closed, so it has no inside to be kept clear "
                "of; leave it out with `ignore`, or give its actor convex collision shapes"
            )
        yield from assets.convex_pieces(shell)
