"""What an episode looks like in rerun: the bridge from simulator, checker and loop to `rf_exp.viz`."""

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import trimesh
from numpy.typing import NDArray

from rf_exp.constraints import RoboChecker
from rf_exp.constraints.occupancy import centres_m, voxels
from rf_exp.constraints.world import Bodies
from rf_exp.datagen.episode import Plan
from rf_exp.robots import LINKS, Panda
from rf_exp.robots.meshes import light_meshes
from rf_exp.sim.simulator import Simulator
from rf_exp.tasks import Task
from rf_exp.types import Scene, Violation
from rf_exp.viz import CameraModel, Mesh, Recorder, camera_entity, link_entity, object_entity

OCCUPANCY_EVERY = 2  # control steps
TABLE_M = (2.4, 2.4, 0.02)  # what is drawn of the table
TABLE_COLOUR = (0.45, 0.40, 0.35)


class EpisodeRecorder:
    """Records one episode; an observer of the generation loop, a context manager.

    The file is complete also when the episode ends in an exception.
    """

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        self._moving = [name for name in world.cameras if task.cameras[name].mount == "wrist"]
        models = {
            name: CameraModel(
                model.width_px,
                model.height_px,
                model.fov_y_rad,
                None if name in self._moving else model.world_from_camera,
            )
            for name, model in world.camera_models().items()
        }
        self._task, self._world = task, world
        self._arms = [Panda(robot.world_from_base) for robot in task.robots]
        self._recorder = Recorder(
            path, task=task.name, title=title, agents=len(task.agents), cameras=models, meshes=_meshes(task)
        )
        self._plan: Plan | None = None
        self._since = 0  # step at which the plan began
        self._step = 0
        self._doing: dict[int, str] = {}
        self._touching = False

    def __enter__(self) -> Self:
        self._recorder.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._recorder.__exit__(kind, error, trace)

    # -- what the generation loop tells an observer ------------------------------------------------

    def planned(self, plan: Plan, checker: RoboChecker) -> None:
        """Proposal, check code and the verdict of every check before anything moves."""
        self._plan, self._since = plan, self._step
        self._recorder.proposal(plan.proposal)
        self._recorder.code(str(plan.code))
        for entry in checker.certificate()["checks"]:
            lane = re.sub(r"\W+", "-", entry["code"]).strip("-")  # what an entity path shows without escapes
            self._recorder.verdict(lane, bool(entry["ok"]), entry["reason"])

    def rejected(self, violation: Violation) -> None:
        self._recorder.violation(violation)

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        """One control step: poses, curves, pictures, occupancy, and what each agent is about."""
        self._step = scene.step + 1
        self.look(scene, action, pictures)
        self._subgoals(scene)

    # -- what a rollout shows ----------------------------------------------------------------------

    def rolled(self, scene: Scene) -> None:
        """One step of a policy: the scene, its pictures, and contact between arms."""
        self.look(scene, None, self._world.pictures())
        touching = scene.arm_contacts
        reason = "; ".join(f"agents {a} and {b} press with {force:.1f} N" for a, b, force in touching)
        if bool(touching) != self._touching:
            self._touching = bool(touching)
            self._recorder.verdict("contact between arms", not touching, reason or "none")

    def look(
        self,
        scene: Scene,
        action: NDArray[np.float64] | None = None,
        pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    ) -> None:
        """The scene as it is, without a plan."""
        poses = {object_entity(name): pose for name, pose in scene.poses.items()}
        for agent, arm in zip(self._task.agents, self._arms, strict=True):
            links = arm.links(scene.qpos[agent - 1])
            poses |= {link_entity(agent, link): pose for link, pose in zip(LINKS, links, strict=True)}
        for name in self._moving:
            poses[camera_entity(name)] = self._world.camera_models()[name].world_from_camera
        self._recorder.step(scene.step, poses=poses, qpos=scene.qpos, action=action, pictures=pictures)
        if scene.step % OCCUPANCY_EVERY == 0:
            self._occupancy(scene)

    def _occupancy(self, scene: Scene) -> None:
        """Voxels of every arm with what it holds, and of the objects that nobody holds."""
        bodies = Bodies(self._task, scene)
        objects = {name: voxels(bodies.standing([name])) for name in self._task.objects}
        for agent, held in zip(self._task.agents, scene.held, strict=True):
            occupied = [voxels(bodies.arm(agent, scene.qpos[agent - 1]))]
            occupied += [objects[held]] if held is not None else []
            self._recorder.occupancy(f"agent{agent}", centres_m(np.unique(np.concatenate(occupied), axis=0)))
        for name, occupied in objects.items():
            self._recorder.occupancy(name, None if name in scene.held else centres_m(occupied))

    def _subgoals(self, scene: Scene) -> None:
        if self._plan is None:
            return
        step = min(scene.step - self._since + 1, len(self._plan.schedule))
        for trajectory in self._plan.trajectories:
            position = int(self._plan.schedule.positions[step, trajectory.agent - 1])
            index = int(np.searchsorted(trajectory.knots[1:], position))
            over = position == len(trajectory)
            text = "" if over or not trajectory.segments else trajectory.segments[index].subgoal.text
            if self._doing.get(trajectory.agent) != text:
                self._doing[trajectory.agent] = text
                self._recorder.subgoal(trajectory.agent, text)


def _meshes(task: Task) -> dict[str, Mesh]:
    """Every entity that is drawn: links of each arm, objects, the table."""
    meshes = {
        link_entity(agent, link): Mesh(vertices, faces, colours)
        for agent in task.agents
        for link, (vertices, faces, colours) in _links().items()
        if link in LINKS
    }
    meshes |= {object_entity(name): _object(task, name) for name in task.objects}
    slab = trimesh.creation.box(TABLE_M)
    slab.apply_translation((0.0, 0.0, -TABLE_M[2] / 2))
    meshes[object_entity("table")] = Mesh(slab.vertices, slab.faces, TABLE_COLOUR)
    return meshes


_links = cache(light_meshes)


def _object(task: Task, name: str) -> Mesh:
    parts = task.asset(name).parts
    colours = np.concatenate([np.tile(part.colour, (len(part.mesh.vertices), 1)) for part in parts])
    offsets = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    faces = np.concatenate([part.mesh.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    return Mesh(vertices, faces, colours)
