"""Writer of MP4 films for browsers: H.264, index first."""

from pathlib import Path
from typing import Self

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import StageError

LOSSLESS_OPTIONS = ["-qp", "0", "-preset", "veryfast", "-g", "10"]  # a key frame at least every ten frames


class Film:
    """Writer of one film. A context manager; `rate` in frames per second.

    `quality` is the constant rate factor of x264: lower is better and larger; None is lossless RGB, which
    browsers do not play. Raises StageError when the file cannot be written.
    """

    def __init__(self, path: Path, rate: int = 20, quality: int | None = 24) -> None:
        self._path, self._rate, self._quality = path, rate, quality
        self._writer, self._frames_added = None, 0

    def add(self, frame: NDArray[np.uint8], times: int = 1) -> None:
        """Adds a frame (H, W, 3) `times` times; all have one size, even unless lossless."""
        try:
            if self._writer is None:
                self._writer = self._open((frame.shape[1], frame.shape[0]))
            for _ in range(times):
                self._writer.send(frame.tobytes())
                self._frames_added += 1
        except OSError as error:
            why = str(error).partition("\n")[0]  # without the ffmpeg command; ffmpeg prints its errors
            raise StageError(f"cannot write the film {self._path}: {why}") from error

    def _open(self, size: tuple[int, int]):
        lossless = self._quality is None
        quality = LOSSLESS_OPTIONS if lossless else ["-crf", str(self._quality), "-preset", "fast"]
        writer = imageio_ffmpeg.write_frames(
            str(self._path),
            size,
            fps=self._rate,
            codec="libx264rgb" if lossless else "libx264",
            pix_fmt_out="rgb24" if lossless else "yuv420p",
            macro_block_size=1 if lossless else 2,
            ffmpeg_log_level="error",
            output_params=[*quality, "-movflags", "+faststart", "-threads", "1"],
        )
        writer.send(None)
        return writer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Completes the film; counts its frames, as a failure of ffmpeg (full disk) shows only in them."""
        if self._writer is None:
            return
        self._writer.close()
        self._writer = None
        try:
            frames, _ = imageio_ffmpeg.count_frames_and_secs(self._path)
        except RuntimeError:  # not a film
            frames = 0
        if frames != self._frames_added:
            raise StageError(
                f"cannot write the film {self._path}: it has {frames} of {self._frames_added} frames; "
                "make room there, and run the same command again"
            )
