"""A performance as a film."""

from pathlib import Path

from rf_exp.gallery.draw import frame
from rf_exp.gallery.performance import Performance, play
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S
from rf_exp.viz import Film

EVERY = 2  # control steps from one frame to the next: at 20 frames a second, twice as fast as real
REST_FRAMES = 20  # the last frame stays a while


def film(path: Path, task: Task, performance: Performance, world: Simulator) -> None:
    """Plays the performance again and writes it to `path`. Raises StageError when that fails."""
    steps = len(performance.actions)
    with Film(path) as writer:
        for step, pictures in play(
            world, performance.seed, performance.actions, {*range(0, steps, EVERY), steps}
        ):
            picture = frame(task, pictures, performance.line(step), step * CONTROL_DT_S)
            writer.add(picture, REST_FRAMES if step == steps else 1)
