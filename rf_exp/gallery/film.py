"""A performance as an MP4 that browsers play: H.264, its index first."""

from pathlib import Path

import imageio_ffmpeg

from rf_exp.errors import StageError
from rf_exp.gallery.draw import frame
from rf_exp.gallery.performance import Performance, play
from rf_exp.sim.simulator import Simulator
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S

EVERY = 2  # control steps from one frame to the next: at 20 frames a second, twice as fast as real
FRAMES_A_SECOND = 20
REST_FRAMES = 20  # the last frame stays a while
QUALITY = "24"  # constant rate factor of x264: lower is better and larger


def film(path: Path, task: Task, performance: Performance, world: Simulator) -> None:
    """Plays the performance again and writes it to `path`. Raises StageError when that fails."""
    steps = len(performance.actions)
    shown = {*range(0, steps, EVERY), steps}
    writer = None
    try:
        for step, pictures in play(world, performance.seed, performance.actions, shown):
            picture = frame(task, pictures, performance.line(step), step * CONTROL_DT_S)
            if writer is None:
                writer = _writer(path, (picture.shape[1], picture.shape[0]))
            for _ in range(REST_FRAMES if step == steps else 1):
                writer.send(picture.tobytes())
    except OSError as error:
        raise StageError(f"cannot write the film {path}: {error}") from error
    finally:
        if writer is not None:
            writer.close()


def _writer(path: Path, size: tuple[int, int]):
    writer = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=FRAMES_A_SECOND,
        codec="libx264",
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-crf", QUALITY, "-preset", "fast", "-movflags", "+faststart", "-threads", "1"],
    )
    writer.send(None)
    return writer
