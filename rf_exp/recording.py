"""What an episode looks like in rerun: the bridge from simulator, checker and loop to `rf_exp.viz`."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import trimesh
from numpy.typing import NDArray

from rf_exp.constraints import RoboChecker
from rf_exp.constraints.clearance import Mask
from rf_exp.constraints.evidence import Check, Evidence
from rf_exp.constraints.occupancy import centres_m, voxels
from rf_exp.constraints.timing import Demands
from rf_exp.constraints.world import Bodies
from rf_exp.datagen.episode import Plan
from rf_exp.robots import LINKS, Panda
from rf_exp.robots.meshes import light_meshes
from rf_exp.sim.simulator import Simulator
from rf_exp.tasks import Task
from rf_exp.types import ARM_JOINTS, Scene, Trajectory, Violation
from rf_exp.viz import Mesh, Recorder, camera_entity, link_entity, object_entity
from rf_exp.viz.text import CheckResult

CAMERAS = "cameras"  # owner of the voxels that they see
OCCUPANCY_EVERY = 2  # control steps
TABLE_M = (2.4, 2.4, 0.02)  # what is drawn of the table
TABLE_COLOUR = (0.45, 0.40, 0.35)


class EpisodeRecorder:
    """Records one episode; an observer of the generation loop, a context manager.

    The file is complete also when the episode ends in an exception.
    """

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        self._moving = [name for name in world.cameras if task.cameras[name].mount == "wrist"]
        self._task, self._world = task, world
        self._arms = [Panda(robot.world_from_base) for robot in task.robots]
        self._recorder = Recorder(
            path,
            task=task.name,
            title=title,
            agents=len(task.agents),
            cameras=world.camera_models(),
            meshes=_meshes(task),
            moving=self._moving,
        )
        self._plan: Plan | None = None
        self._scene: Scene | None = None  # as seen last
        self._since = 0  # step at which the plan began
        self._doing: dict[int, tuple[str, str]] = {}  # agent -> subgoal, primitive
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
        """Proposal, check code, the evidence of every check, the diagrams, and what the cameras saw."""
        self._plan, self._since = plan, 0 if self._scene is None else self._scene.step + 1
        self._recorder.proposal(plan.proposal)
        self._recorder.checked(check_results(checker))
        if checker.plan is not None:
            seen = checker.plan.scene.seen
            if seen is not None:
                self._recorder.occupancy(CAMERAS, centres_m(seen))
            self._recorder.coordination(
                plan.trajectories,
                plan.schedule,
                checker.plan.diagrams,
                orders(checker, plan.trajectories),
            )

    def rejected(self, violation: Violation) -> None:
        """A violation, marked at the hands of the agents involved; it ends what was going on."""
        self._recorder.violation(violation, self._hands_m(violation.agents))
        self._plan = None
        for agent in self._task.agents:
            self._do(agent, "", "")

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        """One control step: poses, curves, pictures, occupancy, and what each agent is about."""
        self.look(scene, action, pictures)
        if self._plan is not None:
            self._follow(self._plan, scene.step - self._since + 1)

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
        self._scene = scene
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

    def _follow(self, plan: Plan, step: int) -> None:
        """What each agent does in a control step of the plan, the first being 1."""
        positions = plan.schedule.positions
        now, before = positions[min(step, len(plan.schedule))], positions[min(step, len(plan.schedule)) - 1]
        self._recorder.positions(now)
        for trajectory in plan.trajectories:
            at = int(now[trajectory.agent - 1])
            moves = at != before[trajectory.agent - 1] and step <= len(plan.schedule)
            if not moves and at == len(trajectory):
                self._do(trajectory.agent, "", "")
                continue
            segment = trajectory.segments[int(np.searchsorted(trajectory.knots[1:], at))]
            self._do(trajectory.agent, segment.subgoal.text, segment.primitive if moves else "")

    def _do(self, agent: int, subgoal: str, primitive: str) -> None:
        if self._doing.get(agent, ("", "")) != (subgoal, primitive):
            self._doing[agent] = subgoal, primitive
            self._recorder.motion(agent, subgoal, primitive)

    def _hands_m(self, agents: tuple[int, ...]) -> NDArray[np.float64]:
        """(K, 3) tool centre points of some agents, as seen last."""
        if self._scene is None:
            return np.zeros((0, 3))
        qpos = self._scene.qpos
        hands = [self._arms[agent - 1].tcp(qpos[agent - 1, :ARM_JOINTS])[:3, 3] for agent in agents]
        return np.array(hands).reshape(-1, 3)


def check_results(checker: RoboChecker) -> tuple[CheckResult, ...]:
    """The evidence of all checks on the plan checked last, ready to be shown."""
    return tuple(check_result(check, evidence) for check, evidence in checker.evidence)


def check_result(check: Check, evidence: Evidence) -> CheckResult:
    """A check with its evidence, ready to be shown."""
    return CheckResult(
        repr(check),
        check.text,
        evidence.ok,
        evidence.value,
        evidence.bound,
        check.unit,
        evidence.time_s,
        evidence.reason,
    )


def orders(checker: RoboChecker, trajectories: Sequence[Trajectory]) -> Mapping[tuple[int, int], Mask]:
    """(P_i, P_j) for pairs of agents i < j: True where the temporal constraints of a plan forbid to be."""
    demands = Demands(trajectories)
    for rule in checker.rules:
        rule.demand(demands)
    return demands.cells


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
