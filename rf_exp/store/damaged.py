"""Damaged data: problems of an episode, and a reader for the intact episodes of a damaged store."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from rf_exp.errors import refuse_access
from rf_exp.store.integrity import Damage, open_group, require_file
from rf_exp.store.layout import build_episode, empty_like, get_array, layout, rows_per_file, view
from rf_exp.store.store import Store
from rf_exp.types import Episode

UNIT_NORM_TOLERANCE = 1e-3  # tolerance of the norm of quaternions


class DamagedStore:
    """Reader of a store that `Store.open` may refuse.

    The arrays are derived from its attributes, so only the files with the rows of an episode must be intact.
    """

    def __init__(self, path: Path, scratch: Path) -> None:
        """`scratch` is an empty folder for temporary files. Raises StageError as `open_group` does."""
        self._path = path
        _, self.attrs = open_group(path, "r")
        empty_like(scratch / "store", self.attrs)
        self._arrays = zarr.open_group(scratch / "store", mode="r", zarr_format=3)
        for name in layout(self.attrs):
            (scratch / "store" / name / "c").symlink_to((path / name / "c").resolve())
        self.ends = self._ends()

    def episode(self, index: int) -> Episode:
        """One episode. Raises Damage naming the part that cannot be read."""
        start, end = (self.ends[index - 1] if index else 0), self.ends[index]
        return build_episode(
            self.attrs,
            self.seed(index),
            lambda: self._certificate(index),
            lambda name: self._read(f"data/{name}", start, end),
        )

    def seed(self, index: int) -> int:
        """The stored seed or, where that is lost, the one in the certificate's row. Raises Damage."""
        try:
            return int(self._read("meta/seed", index, index + 1)[0])
        except Damage:
            with suppress(Damage, LookupError, TypeError, ValueError):
                return int(self._certificate(index)["row"]["seed"])
            raise

    def _certificate(self, index: int) -> Any:
        try:
            return json.loads(str(self._read("meta/certificate", index, index + 1)[0]))
        except ValueError as error:
            raise Damage(f"meta/certificate holds no JSON: {error}") from error

    def _ends(self) -> list[int]:
        """Row after the last of each episode, as far as they can be read and rise.

        Unreadable ones are derived from `time_s`, which restarts with each episode, if that yields more.
        """
        ends = [0]
        stored = self._rows("meta/episode_ends")
        while len(ends) <= stored:
            try:
                end = int(self._read("meta/episode_ends", len(ends) - 1, len(ends))[0])
            except Damage:
                return max(ends[1:], self._ends_by_time(), key=len)
            if end <= ends[-1]:  # zeros, where the number of episodes is unknown
                break
            ends.append(end)
        return ends[1:]

    def _ends_by_time(self) -> list[int]:
        if "data/time_s" not in layout(self.attrs):
            return []
        rows = self._rows("data/time_s")
        try:
            starts = np.flatnonzero(self._read("data/time_s", 0, rows) == 0)
        except Damage:
            return []
        return [*starts[1:].tolist(), rows][: self._rows("meta/certificate")]

    def _rows(self, name: str) -> int:
        """Number of rows of an array: those declared, but at most those of the files present."""
        rows = rows_per_file(get_array(self._arrays, name)) * len(list((self._path / name / "c").glob("*")))
        with suppress(Exception):  # its metadata is lost too
            rows = min(rows, zarr.open_array(self._path / name, mode="r", zarr_format=3).shape[0])
        return rows

    def _read(self, name: str, start: int, end: int) -> np.ndarray[Any, Any]:
        array = get_array(self._arrays, name)
        rows = rows_per_file(array)
        try:
            for row in range(start - start % rows, end, rows):
                require_file(self._path, name, array, row)
            return np.asarray(view(array, end)[start:end])  # resizing it would delete files
        except Exception as error:  # whatever a decoder raises on damaged bytes
            refuse_access(self._path, error)
            raise Damage(f"{name} cannot be read: {error}") from error


def problems(store: Store, index: int) -> list[str]:
    """Problems of one episode, in words; empty for an intact one. Reads all of it."""
    try:
        episode = store.episode(index)
    except Damage as error:
        return [str(error)]
    return [f"episode {index}, seed {episode.seed}: {flaw}" for flaw in flaws(episode)]


def flaws(episode: Episode) -> list[str]:
    """Invalid values of an episode, in words."""
    floats: dict[str, NDArray[Any]] = {
        "qpos": episode.qpos,
        "qvel": episode.qvel,
        "action": episode.action,
        "executed": episode.commanded,
        **{f"pose_{name}": poses for name, poses in episode.poses.items()},
    }
    found = [
        f"{name} holds values that are not finite"
        for name, values in floats.items()
        if not np.isfinite(values).all()
    ]
    found += [
        f"pose_{name} has quaternions that are not of unit length"
        for name, poses in episode.poses.items()
        if (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > UNIT_NORM_TOLERANCE).any()
    ]
    found += [
        f"camera {camera} shows nothing: one colour in every picture"
        for camera, pictures in episode.images.items()
        if (pictures == pictures[0, 0, 0]).all()
    ]
    texts: Any = episode.certificate.get("subgoals")
    if episode.subgoal is not None and texts is not None:
        text_counts = np.array([len(agent_texts) for agent_texts in texts])
        if (episode.subgoal < -1).any() or (episode.subgoal >= np.maximum(text_counts, 1)).any():
            found.append(
                f"subgoal has numbers that its certificate has no text for: {text_counts.tolist()} texts"
            )
    if episode.judged is not None and not episode.judged.holds[-1].all():
        missing = np.array(episode.judged.names)[~episode.judged.holds[-1]].tolist()
        found.append(f"it ends without success: not {', not '.join(missing)}")
    return found
