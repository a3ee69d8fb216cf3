"""The scene as a recording shows it: poses, curves, pictures, and the voxels that everything occupies."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import trimesh
from numpy.typing import NDArray

from rf_exp.geometry import PlanningScene, centres_m, voxels
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.types import Scene
from rf_exp.viz import Mesh, Panels, Recorder, camera_entity, link_entity, object_entity

OCCUPANCY_EVERY = 2  # control steps
TABLE_M = (2.4, 2.4, 0.02)  # what is drawn of the table
TABLE_COLOUR = (0.45, 0.40, 0.35)


class SceneRecorder:
    """Records scenes; a context manager. The file is complete also when the body ends in an exception."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str, panels: Panels) -> None:
        self._moving = [name for name in world.cameras if task.cameras[name].mount == "wrist"]
        self._task, self._world = task, world
        self._arms = tuple(task.arms.values())
        self._recorder = Recorder(
            path,
            task=task.name,
            title=title,
            agents=len(task.agents),
            cameras=world.camera_models(),
            meshes=_meshes(task),
            moving=self._moving,
            panels=panels,
            robots=[robot.model for robot in task.robots],
        )
        self._scene: Scene | None = None  # as seen last

    def __enter__(self) -> Self:
        self._recorder.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._recorder.__exit__(kind, error, trace)

    def look(
        self,
        scene: Scene,
        action: NDArray[np.float64] | None = None,
        pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    ) -> None:
        """The scene as it is, without a plan."""
        self._scene = scene
        poses = {object_entity(name): pose for name, pose in {**scene.poses, **scene.clutter}.items()}
        for agent, arm in zip(self._task.agents, self._arms, strict=True):
            links = arm.links(scene.qpos[agent - 1])
            poses |= {
                link_entity(agent, link): pose for link, pose in zip(arm.robot.links, links, strict=True)
            }
        for name in self._moving:
            poses[camera_entity(name)] = self._world.camera_models()[name].world_from_camera
        self._recorder.step(scene.step, poses=poses, qpos=scene.qpos, action=action, pictures=pictures)
        if scene.step % OCCUPANCY_EVERY == 0:
            self._occupancy(scene)

    def _occupancy(self, scene: Scene) -> None:
        """Voxels of every arm with what it holds, and of the objects that nobody holds."""
        planning_scene = PlanningScene(self._task, scene)
        names = (*self._task.objects, *self._task.clutter)
        objects = {name: voxels(planning_scene.standing([name])) for name in names}
        for agent, held in zip(self._task.agents, scene.held, strict=True):
            occupied = [voxels(planning_scene.measured(agent))]
            occupied += [objects[held]] if held is not None else []
            self._recorder.occupancy(f"agent{agent}", centres_m(np.unique(np.concatenate(occupied), axis=0)))
        for name, occupied in objects.items():
            self._recorder.occupancy(name, None if name in scene.held else centres_m(occupied))

    def _hands_m(self, agents: tuple[int, ...]) -> NDArray[np.float64]:
        """(K, 3) tool centre points of some agents, as seen last."""
        if self._scene is None:
            return np.zeros((0, 3))
        qpos = self._scene.qpos
        hands = [self._arms[agent - 1].tcp(qpos[agent - 1])[:3, 3] for agent in agents]
        return np.array(hands).reshape(-1, 3)


def _meshes(task: Task) -> dict[str, Mesh]:
    """Every entity that is drawn: links of each arm, objects, the table."""
    meshes = {
        link_entity(agent, link): Mesh(vertices, faces, colours)
        for agent, robot in zip(task.agents, task.robots, strict=True)
        for link, (vertices, faces, colours) in robot.model.meshes.items()
        if link in robot.model.links
    }
    meshes |= {object_entity(name): _object(task, name) for name in (*task.objects, *task.clutter)}
    slab = trimesh.creation.box(TABLE_M)
    slab.apply_translation((0.0, 0.0, -TABLE_M[2] / 2))
    meshes[object_entity("table")] = Mesh(slab.vertices, slab.faces, TABLE_COLOUR)
    return meshes


def _object(task: Task, name: str) -> Mesh:
    parts = task.asset(name).parts
    colours = np.concatenate([np.tile(part.colour, (len(part.mesh.vertices), 1)) for part in parts])
    offsets = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    faces = np.concatenate([part.mesh.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    return Mesh(vertices, faces, colours)
