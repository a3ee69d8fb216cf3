"""Recorders of episodes and rollouts: the bridge from simulator, checker and loops to `rf_exp.viz`."""

from collections import deque
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import cast

import numpy as np
import trimesh
from numpy.typing import NDArray

from rf_exp.constraints import Check, CheckedPlan, Evidence, Paths, RoboChecker
from rf_exp.coordination import Demands
from rf_exp.datagen import Planned
from rf_exp.findings import Violation
from rf_exp.geometry import Mask, PlanningScene, centres_m, voxels
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.texts.markdown import Markdown
from rf_exp.types import CONTROL_HZ, KeypointDetection, Rollout, RolloutStep, Scene, Verdict, activity
from rf_exp.viz import Mesh, Panels, Recorder, camera_entity, link_entity, object_entity, text
from rf_exp.viz.text import CheckResult

OCCUPANCY_EVERY = DISTANCES_EVERY = PICTURES_EVERY = 2  # control steps
TRAIL_STEPS = 2 * CONTROL_HZ  # length of the trail behind a gripper
HIGHEST = 3.0  # larger ratios of a value to its bound are clipped
TABLE_M = (2.4, 2.4, 0.02)  # size of the displayed table
TABLE_COLOUR = (0.45, 0.40, 0.35)
CAMERAS = "cameras"  # owner of the voxels seen by depth cameras


class SceneRecorder(Recorder):
    """Recorder of the scenes of a task in a simulator."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str, panels: Panels) -> None:
        self._task, self._world = task, world
        self._arms = tuple(task.arms.values())
        self._scene: Scene | None = None  # the last one
        super().__init__(
            path,
            task=task.name,
            title=title,
            agents=len(task.agents),
            cameras=world.camera_models(),
            meshes=_meshes(task),
            moving=[name for name in world.cameras if task.cameras[name].mount == "wrist"],
            panels=panels,
            robots=[robot.model for robot in task.robots],
        )

    def look(
        self,
        scene: Scene,
        action: NDArray[np.float64] | None = None,
        pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    ) -> None:
        """Records the present scene, without a plan."""
        self._scene = scene
        poses = {object_entity(name): pose for name, pose in {**scene.poses, **scene.clutter}.items()}
        for agent, arm in zip(self._task.agents, self._arms, strict=True):
            links = arm.links(scene.qpos[agent - 1])
            poses |= {
                link_entity(agent, link): pose for link, pose in zip(arm.robot.links, links, strict=True)
            }
        for name in self._moving:
            poses[camera_entity(name)] = self._world.camera_models()[name].world_from_camera
        self.step(scene.step, poses=poses, qpos=scene.qpos, action=action, pictures=pictures)
        if scene.step % OCCUPANCY_EVERY == 0:
            self._occupancy(scene)

    def _occupancy(self, scene: Scene) -> None:
        """Records the voxels of every arm with its load, and of the objects that no arm holds."""
        planning_scene = PlanningScene(self._task, scene)
        names = (*self._task.objects, *self._task.clutter)
        objects = {name: voxels(planning_scene.standing([name])) for name in names}
        for agent, held in zip(self._task.agents, scene.held, strict=True):
            occupied = [voxels(planning_scene.measured(agent))]
            occupied += [objects[held]] if held is not None else []
            self.occupancy(f"agent{agent}", centres_m(np.unique(np.concatenate(occupied), axis=0)))
        for name, occupied in objects.items():
            self.occupancy(name, None if name in scene.held else centres_m(occupied))

    def _hands_m(self, agents: tuple[int, ...]) -> NDArray[np.float64]:
        """(K, 3) tool centre points of some agents in the last scene."""
        if self._scene is None:
            return np.zeros((0, 3))
        qpos = self._scene.qpos
        hands = [self._arms[agent - 1].tcp(qpos[agent - 1])[:3, 3] for agent in agents]
        return np.array(hands).reshape(-1, 3)


def _meshes(task: Task) -> dict[str, Mesh]:
    """The meshes of all entities: links of each arm, objects, the table."""
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
    whole = cast(trimesh.Trimesh, trimesh.util.concatenate([part.mesh for part in parts]))
    counts = [len(part.mesh.vertices) for part in parts]
    return Mesh(whole.vertices, whole.faces, np.repeat([part.colour for part in parts], counts, axis=0))


class EpisodeRecorder(SceneRecorder):
    """Recorder of one episode; an observer of the generation loop."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "plan")
        self._plan: Planned | None = None
        self._since = 0  # step at which the plan began
        self._doing: dict[int, tuple[str, str]] = {}  # agent -> subgoal, primitive

    def planned(self, plan: Planned) -> None:
        """Records proposal, check code with evidence, coordination diagrams, and voxels seen by cameras."""
        self._plan, self._since = plan, 0 if self._scene is None else self._scene.step + 1
        self.proposal(plan.proposal)
        self.checked(check_results(plan.checked))
        paths = plan.checked.plan.paths
        if paths.scene.seen is not None:
            self.occupancy(CAMERAS, centres_m(paths.scene.seen))
        self.coordination(plan.trajectories, plan.schedule, paths.diagrams, orders(plan.checker, paths))

    def rejected(self, violation: Violation) -> None:
        """Records a violation, marked at the grippers of its agents, and ends their subgoals."""
        self.violation(violation, self._hands_m(violation.agents))
        self._plan = None
        for agent in self._task.agents:
            self._do(agent, "", "")

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        """Records one control step: poses, curves, pictures, occupancy, and the subgoal of each agent."""
        self.look(scene, action, pictures)
        if self._plan is None:
            return
        schedule, step = self._plan.schedule, scene.step - self._since + 1  # of the plan, the first being 1
        self.positions(schedule.positions[min(step, len(schedule))])
        for trajectory in self._plan.trajectories:
            now = activity(trajectory, schedule, step)
            subgoal, primitive = "", ""
            if now.segment is not None:
                subgoal, primitive = now.segment.subgoal.text, now.segment.primitive if now.moves else ""
            self._do(trajectory.agent, subgoal, primitive)

    def _do(self, agent: int, subgoal: str, primitive: str) -> None:
        if self._doing.get(agent, ("", "")) != (subgoal, primitive):
            self._doing[agent] = subgoal, primitive
            self.motion(agent, subgoal, primitive)


def check_results(checked: CheckedPlan) -> tuple[CheckResult, ...]:
    """The evidence of all checks on a plan, for display."""
    return tuple(map(check_result, checked.checks, checked.evidence))


def check_result(check: Check, evidence: Evidence) -> CheckResult:
    """A check with its evidence, for display."""
    found = evidence.value, evidence.bound, check.unit, evidence.time_s, evidence.sentence
    return CheckResult(repr(check), check.text, evidence.ok, *found)


def orders(checker: RoboChecker, paths: Paths) -> Mapping[tuple[int, int], Mask]:
    """(P_i, P_j) for pairs of agents i < j: True for positions that the temporal demands of a plan forbid."""
    return Demands(paths.trajectories, checker.rules(paths)).cells


class RolloutRecorder(SceneRecorder):
    """Recorder of one rollout; an observer of the rollout loop."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "rollout")
        self._trails = {agent: deque[NDArray[np.float64]](maxlen=TRAIL_STEPS) for agent in task.agents}
        self._since: dict[str, int] = {}  # condition -> step of its last change
        self._evidence: dict[str, bool] = {}
        self._pushes: set[str] = set()  # contacts recorded so far
        self._violated = False
        self._table = Markdown()
        self._withheld = ""  # the last text about the shield
        self._doing: dict[int, int] = {}  # agent -> number of its subgoal
        self._detections: tuple[KeypointDetection, ...] = ()

    def begun(self, scene: Scene) -> None:
        self.look(scene, None, self._world.images())
        self._distances(scene)

    def rolled(self, step: RolloutStep) -> None:
        for agent, chunk in step.predicted.items():  # predicted before the step
            self.predicted(agent, step.scene.step, chunk)
            ahead = self._arms[agent - 1].tcp(chunk)[:, :3, 3]
            self.path(agent, "predicted", ahead)
        pictures = self._world.images() if step.scene.step % PICTURES_EVERY == 0 else None
        self.look(step.scene, step.action, pictures)
        if step.detections != self._detections:
            self._detections = step.detections
            self.detections(step.detections)
        for agent in self._task.agents:
            self._trails[agent].append(self._hands_m((agent,))[0])
            self.path(agent, "done", np.array(self._trails[agent]))
        if step.scene.step % DISTANCES_EVERY == 0:
            self._distances(step.scene)
        self._contacts(step.scene)
        self._judged(step.scene, step.verdict)
        self._shielded(step)
        for agent, (number, goes_on) in step.phases.items():
            self._state(f"agent {agent}", goes_on, step.scene.step, ("goes on", "waits"))
            if self._doing.get(agent) != number:
                self._doing[agent] = number
                self.note(f"agent {agent} takes itself to be at its subgoal {number + 1}")
        if step.violation is not None and not self._violated:
            self.violation(step.violation, self._hands_m(step.violation.agents))
        self._violated = step.violation is not None

    def ended(self, result: Rollout) -> None:
        """Records the outcome."""
        self.judged(Markdown(f"{text.outcome(result)}\n\n{self._table}"))
        self.note(f"{'success' if result.success else result.reason}, step {result.steps}")

    def _distances(self, scene: Scene) -> None:
        planning_scene = PlanningScene(self._task, scene)
        for a, b in combinations(self._task.agents, 2):
            self.distance(a, b, planning_scene.between(a, b).distance_m)

    def _contacts(self, scene: Scene) -> None:
        """Records forces between arms, of fingers on objects, and on clutter."""
        forces = {f"agents {a} and {b}": force for a, b, force in scene.arm_contacts}
        forces |= {
            f"agent {agent} on {name}": float(np.linalg.norm(force))
            for (agent, name), force in scene.finger_forces.items()
        }
        forces |= {f"{who} on {name}": force for who, name, force in scene.clutter_contacts}
        for what in sorted(self._pushes | forces.keys()):
            self.contact(what, forces.get(what, 0.0))
        self._pushes |= forces.keys()
        if len(self._task.agents) > 1:
            self._state("arms apart", not scene.arm_contacts, scene.step, ("holds", "touching"))

    def _judged(self, scene: Scene, verdict: Verdict) -> None:
        for name, holds in verdict.evidence.items():
            self._state(name, holds, scene.step, ("holds", "not yet"))
        for name in self._task.objects:
            self._state(f"{name} at hand", name not in verdict.lost, scene.step, ("holds", "lost"))
        for name, found in verdict.measured.items():
            self.margin(f"{name} ({found.asked} {found.unit})", min(found.value / found.bound, HIGHEST))
        self._table = text.conditions(verdict, self._since)
        self.judged(self._table)

    def _shielded(self, step: RolloutStep) -> None:
        """Records in a lane when a shield withholds commands, and in the log from which agents and why."""
        if step.withheld is None:
            return
        self._state("shield", not step.withheld, step.scene.step, ("holds", "steps in"))
        said = text.withheld(step.withheld)
        if step.withheld and said != self._withheld:
            self.note(said)
        self._withheld = said

    def _state(self, name: str, holds: bool, step: int, states: tuple[str, str]) -> None:
        """Records a change of a condition in its lane."""
        if self._evidence.get(name) is not holds:
            self._evidence[name], self._since[name] = holds, step
            self.condition(name, holds, f"{name}: {states[0] if holds else states[1]}", states)
