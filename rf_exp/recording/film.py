"""Short film of a rollout and picture of its last step, small enough for a report."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import CONTROL_DT_S, CONTROL_HZ, Rollout, RolloutStep, Scene
from rf_exp.viz import HOLDS, VIOLATED, Film, agent_colour, text
from rf_exp.viz.frames import FAINT_INK, INK, Line, Mark, frame

STEPS_PER_FRAME = 4  # control steps from one frame to the next
FRAMES_PER_SECOND = 2 * CONTROL_HZ // STEPS_PER_FRAME  # frames per second: twice real time
FINAL_FRAMES = 2 * FRAMES_PER_SECOND  # for which the last picture stays
HEIGHT_PX = 240  # of the global view
QUALITY = 28  # see Film


class RolloutFilm(Film):
    """Film of one rollout: an observer of the rollout loop, and a context manager.

    Shows all cameras, the time, and which conditions of success hold. A detected keypoint is a ring of the
    agent's colour where the agent goes next, otherwise a dot. The last picture is written to `picture`.
    """

    def __init__(self, path: Path, picture: Path, task: Task, world: Simulator) -> None:
        super().__init__(path, FRAMES_PER_SECOND, QUALITY)
        self._picture, self._world = picture, world
        self._last: RolloutStep | None = None

    def begun(self, scene: Scene) -> None:
        """Skips the start, which has no verdict."""

    def rolled(self, step: RolloutStep) -> None:

        self._last = step
        if step.scene.step % STEPS_PER_FRAME == 0:
            self.add(self._frame(step, ""))

    def ended(self, result: Rollout) -> None:
        """Adds and saves the last step, with the outcome."""
        assert self._last is not None  # a rollout has at least one step
        picture = self._frame(self._last, ", succeeded" if result.success else ", failed")
        self.add(picture, FINAL_FRAMES)
        Image.fromarray(picture).save(self._picture)

    def _frame(self, step: RolloutStep, ending: str) -> NDArray[np.uint8]:
        title = f"{step.scene.step * CONTROL_DT_S:.1f} s{ending}"
        marks = [Mark(s.camera, s.x, s.y, agent_colour(s.agent), s.is_next) for s in step.detections]
        return frame(self._world.images(), title, _lines(step), HEIGHT_PX, marks)


def _lines(step: RolloutStep) -> list[Line]:
    """A line for each condition: a mark in green where it holds, and its measured value, if any.

    With a shield, one more for what it does.
    """
    lines, verdict = [], step.verdict
    for name, holds in verdict.evidence.items():
        measured = verdict.measured.get(name)
        suffix = (
            f": {text.measured(measured, 2)}, asked {measured.requirement}" if measured is not None else ""
        )
        lines.append(Line(f"{name}{suffix}", HOLDS if holds else VIOLATED, INK if holds else FAINT_INK))
    if step.withheld is not None:
        shield_text = text.withheld(step.withheld)
        lines.append(
            Line(shield_text, VIOLATED if step.withheld else HOLDS, INK if step.withheld else FAINT_INK)
        )
    return lines


def show_measured_state(world: Simulator, step: RolloutStep) -> None:
    """Puts arms and objects of another simulator at the poses measured in a step; nothing is simulated."""
    poses = {**step.scene.poses, **step.scene.clutter}
    object_poses = {name: np.array(position_and_quaternion(pose)) for name, pose in poses.items()}
    world.place(step.scene.qpos, object_poses)
