"""A policy at work: what it predicted beside what was done, and how it was judged, step by step."""

from collections import deque
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry import PlanningScene
from rf_exp.recording.scene import SceneRecorder
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.texts.markdown import Markdown
from rf_exp.types import CONTROL_HZ, KeypointDetection, Rollout, RolloutStep, Scene, Verdict
from rf_exp.viz import text

DISTANCES_EVERY = 2  # control steps
TRAIL_STEPS = 2 * CONTROL_HZ  # of the hand, shown behind it
HIGHEST = 3.0  # a number that is further off than this many bounds is drawn there


class RolloutRecorder(SceneRecorder):
    """Records one rollout; an observer of the rollout loop, a context manager."""

    def __init__(self, path: Path, task: Task, world: Simulator, title: str) -> None:
        super().__init__(path, task, world, title, "rollout")
        self._trails = {agent: deque[NDArray[np.float64]](maxlen=TRAIL_STEPS) for agent in task.agents}
        self._since: dict[str, int] = {}  # condition -> step since which it is as it is
        self._evidence: dict[str, bool] = {}
        self._pushes: set[str] = set()  # who pushes what, as shown so far
        self._violated = False
        self._table = Markdown()
        self._withheld = ""  # what the shield did last
        self._doing: dict[int, int] = {}  # agent -> number of its subgoal
        self._detections: tuple[KeypointDetection, ...] = ()

    def begun(self, scene: Scene) -> None:
        """The start."""
        self.look(scene, None, self._world.images())
        self._distances(scene)

    def rolled(self, step: RolloutStep) -> None:
        """One control step."""
        for agent, chunk in step.predicted.items():  # made before the step, from where the hands were
            self._recorder.predicted(agent, step.scene.step, chunk)
            ahead = self._arms[agent - 1].tcp(chunk)[:, :3, 3]
            self._recorder.path(agent, "predicted", ahead)
        self.look(step.scene, step.action, self._world.images())
        if step.detections != self._detections:
            self._detections = step.detections
            self._recorder.detections(step.detections)
        for agent in self._task.agents:
            self._trails[agent].append(self._hands_m((agent,))[0])
            self._recorder.path(agent, "done", np.array(self._trails[agent]))
        if step.scene.step % DISTANCES_EVERY == 0:
            self._distances(step.scene)
        self._contacts(step.scene)
        self._judged(step.scene, step.verdict)
        self._shielded(step)
        for agent, (number, goes_on) in step.phases.items():
            self._state(f"agent {agent}", goes_on, step.scene.step, ("goes on", "waits"))
            if self._doing.get(agent) != number:
                self._doing[agent] = number
                self._recorder.note(f"agent {agent} takes itself to be at its subgoal {number + 1}")
        if step.violation is not None and not self._violated:
            self._recorder.violation(step.violation, self._hands_m(step.violation.agents))
        self._violated = step.violation is not None

    def ended(self, result: Rollout) -> None:
        """The verdict on the whole."""
        self._recorder.judged(Markdown(f"{text.outcome(result)}\n\n{self._table}"))
        self._recorder.note(f"{'success' if result.success else result.reason}, step {result.steps}")

    def _distances(self, scene: Scene) -> None:
        planning_scene = PlanningScene(self._task, scene)
        for a, b in combinations(self._task.agents, 2):
            self._recorder.distance(a, b, planning_scene.between(a, b).distance_m)

    def _contacts(self, scene: Scene) -> None:
        """Forces between arms, and of fingers on objects."""
        forces = {f"agents {a} and {b}": force for a, b, force in scene.arm_contacts}
        forces |= {
            f"agent {agent} on {name}": float(np.linalg.norm(force))
            for (agent, name), force in scene.finger_forces.items()
        }
        forces |= {f"{who} on {name}": force for who, name, force in scene.clutter_contacts}
        for what in sorted(self._pushes | forces.keys()):
            self._recorder.contact(what, forces.get(what, 0.0))
        self._pushes |= forces.keys()
        if len(self._task.agents) > 1:
            self._state("arms apart", not scene.arm_contacts, scene.step, ("holds", "touching"))

    def _judged(self, scene: Scene, verdict: Verdict) -> None:
        for name, holds in verdict.evidence.items():
            self._state(name, holds, scene.step, ("holds", "not yet"))
        for name in self._task.objects:
            self._state(f"{name} at hand", name not in verdict.lost, scene.step, ("holds", "lost"))
        for name, found in verdict.measured.items():
            self._recorder.margin(
                f"{name} ({found.asked} {found.unit})", min(found.value / found.bound, HIGHEST)
            )
        self._table = text.conditions(verdict, self._since)
        self._recorder.judged(self._table)

    def _shielded(self, step: RolloutStep) -> None:
        """A lane that tells when a shield keeps an arm from its command; in the log, whom and why."""
        if step.withheld is None:
            return
        self._state("shield", not step.withheld, step.scene.step, ("holds", "steps in"))
        said = text.withheld(step.withheld)
        if step.withheld and said != self._withheld:
            self._recorder.note(said)
        self._withheld = said

    def _state(self, name: str, holds: bool, step: int, states: tuple[str, str]) -> None:
        """A lane changes where a condition does."""
        if self._evidence.get(name) is not holds:
            self._evidence[name], self._since[name] = holds, step
            self._recorder.condition(name, holds, f"{name}: {states[0] if holds else states[1]}", states)
