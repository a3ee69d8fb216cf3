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
MAX_RATIO = 3.0  # larger ratios of a value to its bound are clipped
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

    def record_scene(
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
        objects = {name: voxels(planning_scene.static_objects([name])) for name in names}
        for agent, held in zip(self._task.agents, scene.held, strict=True):
            cells = [voxels(planning_scene.measured(agent))]
            cells += [objects[held]] if held is not None else []
            self.occupancy(f"agent{agent}", centres_m(np.unique(np.concatenate(cells), axis=0)))
        for name, cells in objects.items():
            self.occupancy(name, None if name in scene.held else centres_m(cells))

    def _tcps_m(self, agents: tuple[int, ...]) -> NDArray[np.float64]:
        """(K, 3) tool centre points of some agents in the last scene."""
        if self._scene is None:
            return np.zeros((0, 3))
        qpos = self._scene.qpos
        positions_m = [self._arms[agent - 1].tcp(qpos[agent - 1])[:3, 3] for agent in agents]
        return np.array(positions_m).reshape(-1, 3)


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
    merged = cast(trimesh.Trimesh, trimesh.util.concatenate([part.mesh for part in parts]))
    counts = [len(part.mesh.vertices) for part in parts]
    return Mesh(merged.vertices, merged.faces, np.repeat([part.colour for part in parts], counts, axis=0))


class EpisodeRecorder(SceneRecorder):
    """Recorder of one episode; an observer of the generation loop."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "plan")
        self._plan: Planned | None = None
        self._plan_start = 0  # step at which the plan began
        self._active: dict[int, tuple[str, str]] = {}  # agent -> subgoal, primitive

    def planned(self, plan: Planned) -> None:
        """Records proposal, check code with evidence, coordination diagrams, and voxels seen by cameras."""
        self._plan, self._plan_start = plan, 0 if self._scene is None else self._scene.step + 1
        self.proposal(plan.proposal)
        self.plan_checks(check_results(plan.checked))
        paths = plan.checked.plan.paths
        if paths.scene.occupied_voxels is not None:
            self.occupancy(CAMERAS, centres_m(paths.scene.occupied_voxels))
        self.coordination(plan.trajectories, plan.schedule, paths.diagrams, order_masks(plan.checker, paths))

    def rejected(self, violation: Violation) -> None:
        """Records a violation, marked at the grippers of its agents, and ends their subgoals."""
        self.violation(violation, self._tcps_m(violation.agents))
        self._plan = None
        for agent in self._task.agents:
            self._record_motion(agent, "", "")

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        """Records one control step: poses, curves, pictures, occupancy, and the subgoal of each agent."""
        self.record_scene(scene, action, pictures)
        if self._plan is None:
            return
        schedule, step = self._plan.schedule, scene.step - self._plan_start + 1  # of the plan, from 1
        self.path_positions(schedule.positions[min(step, len(schedule))])
        for trajectory in self._plan.trajectories:
            now = activity(trajectory, schedule, step)
            subgoal, primitive = "", ""
            if now.segment is not None:
                subgoal, primitive = now.segment.subgoal.text, now.segment.primitive if now.moves else ""
            self._record_motion(trajectory.agent, subgoal, primitive)

    def _record_motion(self, agent: int, subgoal: str, primitive: str) -> None:
        if self._active.get(agent, ("", "")) != (subgoal, primitive):
            self._active[agent] = subgoal, primitive
            self.motion(agent, subgoal, primitive)


def check_results(checked: CheckedPlan) -> tuple[CheckResult, ...]:
    """The evidence of all checks on a plan, for display."""
    return tuple(map(check_result, checked.checks, checked.evidence))


def check_result(check: Check, evidence: Evidence) -> CheckResult:
    """A check with its evidence, for display."""
    details = evidence.value, evidence.bound, check.unit, evidence.time_s, evidence.sentence
    return CheckResult(repr(check), check.text, evidence.ok, *details)


def order_masks(checker: RoboChecker, paths: Paths) -> Mapping[tuple[int, int], Mask]:
    """(P_i, P_j) for pairs of agents i < j: True for positions that the temporal demands of a plan forbid."""
    return Demands(paths.trajectories, checker.rules(paths)).cells


class RolloutRecorder(SceneRecorder):
    """Recorder of one rollout; an observer of the rollout loop."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "rollout")
        self._trails = {agent: deque[NDArray[np.float64]](maxlen=TRAIL_STEPS) for agent in task.agents}
        self._changed_at: dict[str, int] = {}  # condition -> step of its last change
        self._evidence: dict[str, bool] = {}
        self._touching: set[str] = set()  # contacts recorded so far
        self._violated = False
        self._table = Markdown()
        self._shield_text = ""  # the last text about the shield
        self._subgoal_numbers: dict[int, int] = {}  # agent -> number of its subgoal
        self._detections: tuple[KeypointDetection, ...] = ()

    def begun(self, scene: Scene) -> None:
        self.record_scene(scene, None, self._world.images())
        self._record_distances(scene)

    def rolled(self, step: RolloutStep) -> None:
        for agent, chunk in step.predicted.items():  # predicted before the step
            self.predicted_targets(agent, step.scene.step, chunk)
            predicted_m = self._arms[agent - 1].tcp(chunk)[:, :3, 3]
            self.path(agent, "predicted", predicted_m)
        pictures = self._world.images() if step.scene.step % PICTURES_EVERY == 0 else None
        self.record_scene(step.scene, step.action, pictures)
        if step.detections != self._detections:
            self._detections = step.detections
            self.detections(step.detections)
        for agent in self._task.agents:
            self._trails[agent].append(self._tcps_m((agent,))[0])
            self.path(agent, "done", np.array(self._trails[agent]))
        if step.scene.step % DISTANCES_EVERY == 0:
            self._record_distances(step.scene)
        self._record_contacts(step.scene)
        self._record_verdict(step.scene, step.verdict)
        self._record_shield(step)
        for agent, (number, proceeds) in step.phases.items():
            self._record_condition(f"agent {agent}", proceeds, step.scene.step, ("goes on", "waits"))
            if self._subgoal_numbers.get(agent) != number:
                self._subgoal_numbers[agent] = number
                self.note(f"agent {agent} takes itself to be at its subgoal {number + 1}")
        if step.violation is not None and not self._violated:
            self.violation(step.violation, self._tcps_m(step.violation.agents))
        self._violated = step.violation is not None

    def ended(self, result: Rollout) -> None:
        """Records the outcome."""
        self.judgement(Markdown(f"{text.outcome(result)}\n\n{self._table}"))
        self.note(f"{'success' if result.success else result.reason}, step {result.steps}")

    def _record_distances(self, scene: Scene) -> None:
        planning_scene = PlanningScene(self._task, scene)
        for a, b in combinations(self._task.agents, 2):
            self.distance(a, b, planning_scene.between(a, b).distance_m)

    def _record_contacts(self, scene: Scene) -> None:
        """Records forces between arms, of fingers on objects, and on clutter."""
        forces = {f"agents {a} and {b}": force for a, b, force in scene.arm_contacts}
        forces |= {
            f"agent {agent} on {name}": float(np.linalg.norm(force))
            for (agent, name), force in scene.finger_forces.items()
        }
        forces |= {f"{toucher} on {name}": force for toucher, name, force in scene.clutter_contacts}
        for pair in sorted(self._touching | forces.keys()):
            self.contact(pair, forces.get(pair, 0.0))
        self._touching |= forces.keys()
        if len(self._task.agents) > 1:
            self._record_condition("arms apart", not scene.arm_contacts, scene.step, ("holds", "touching"))

    def _record_verdict(self, scene: Scene, verdict: Verdict) -> None:
        for name, holds in verdict.evidence.items():
            self._record_condition(name, holds, scene.step, ("holds", "not yet"))
        for name in self._task.objects:
            self._record_condition(f"{name} at hand", name not in verdict.lost, scene.step, ("holds", "lost"))
        for name, measurement in verdict.measured.items():
            self.margin(
                f"{name} ({measurement.requirement} {measurement.unit})",
                min(measurement.value / measurement.bound, MAX_RATIO),
            )
        self._table = text.conditions(verdict, self._changed_at)
        self.judgement(self._table)

    def _record_shield(self, step: RolloutStep) -> None:
        """Records in a lane when a shield withholds commands, and in the log from which agents and why."""
        if step.withheld is None:
            return
        self._record_condition("shield", not step.withheld, step.scene.step, ("holds", "steps in"))
        shield_text = text.withheld(step.withheld)
        if step.withheld and shield_text != self._shield_text:
            self.note(shield_text)
        self._shield_text = shield_text

    def _record_condition(self, name: str, holds: bool, step: int, states: tuple[str, str]) -> None:
        """Records a change of a condition in its lane."""
        if self._evidence.get(name) is not holds:
            self._evidence[name], self._changed_at[name] = holds, step
            self.condition(name, holds, f"{name}: {states[0] if holds else states[1]}", states)
