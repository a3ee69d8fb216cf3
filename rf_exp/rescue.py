"""What can be kept of a damaged store: its whole episodes, in a new one. The damaged one is moved aside.

python -m rf_exp.rescue outputs/data/lift_barrier/full/quick.zarr             keeps what is whole
python -m rf_exp.rescue outputs/data/lift_barrier/full/quick.zarr --dry-run   says what that is
"""

import argparse
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import zarr

from rf_exp.command import guarded
from rf_exp.errors import StageError
from rf_exp.progress import console
from rf_exp.stages.artifacts import owned
from rf_exp.store import Store, empty_like
from rf_exp.types import Episode


class Damaged:
    """A store that `Store.open` may refuse, read as far as it goes: attributes, ends, then each episode.

    The shapes and types of its arrays follow from its attributes, so that only the files with the rows
    themselves have to be whole.
    """

    def __init__(self, path: Path, frame: Path) -> None:
        """`frame` is an empty folder of which it makes use. Raises StageError without attributes."""
        self._path = path
        try:
            self.attrs: dict[str, Any] = dict(zarr.open_group(path, mode="r", zarr_format=3).attrs)
            empty_like(frame / "store", self.attrs)
        except Exception as error:  # whatever damaged bytes lead to
            raise StageError(
                f"{path} has no attributes that can be read ({type(error).__name__}: {error}), and "
                "nothing can be rescued without; restore it from a copy, or delete it and generate again"
            ) from error
        self._arrays = zarr.open_group(frame / "store", mode="r+", zarr_format=3)
        for name in self._names():
            (frame / "store" / name / "c").symlink_to((path / name / "c").resolve())
        self.ends = self._ends()
        for name in self._names():
            rows = self.ends[-1] if self.ends and name.startswith("data/") else len(self.ends)
            array = self._array(name)
            array.resize((rows, *array.shape[1:]))

    def episode(self, index: int) -> Episode:
        """One episode. Raises StageError that says which part of it cannot be read."""
        start, end = (self.ends[index - 1] if index else 0), self.ends[index]
        try:
            certificate = json.loads(str(self._read("meta/certificate", index, index + 1)[0]))
        except ValueError as error:
            raise StageError(f"meta/certificate holds no JSON: {error}") from error
        return Episode(
            task=str(self.attrs["task"]),
            seed=self.seed(index),
            qpos=self._read("data/qpos", start, end),
            qvel=self._read("data/qvel", start, end),
            action=self._read("data/action", start, end),
            pictures={each: self._read(f"data/rgb_{each}", start, end) for each in self.attrs["cameras"]},
            certificate=certificate,
            **self._optional(start, end),
        )

    def _optional(self, start: int, end: int) -> dict[str, Any]:
        """What not every store keeps."""
        found: dict[str, Any] = {
            "poses": {
                name: self._read(f"data/pose_{name}", start, end) for name in self.attrs.get("objects", ())
            }
        }
        for name in ("executed", "subgoal"):
            if name in self._arrays["data"]:  # pyright: ignore[reportOperatorIssue]
                found[name] = self._read(f"data/{name}", start, end)
        return found

    def seed(self, index: int) -> int:
        """Raises StageError where it cannot be read."""
        return int(self._read("meta/seed", index, index + 1)[0])

    def _ends(self) -> list[int]:
        """The row after the last of each episode, as far as they can be read and rise."""
        array, found = self._array("meta/episode_ends"), [0]
        try:
            stored = zarr.open_array(self._path / "meta/episode_ends", mode="r", zarr_format=3).shape[0]
        except Exception:  # lost as well; the rows behind the last are zeros
            stored = array.chunks[0] * len(list((self._path / "meta/episode_ends/c").glob("*")))
        array.resize((stored,))
        while len(found) <= stored:
            try:
                end = int(self._read("meta/episode_ends", len(found) - 1, len(found))[0])
            except StageError:
                break
            if end <= found[-1]:
                break
            found.append(end)
        return found[1:]

    def _names(self) -> Iterator[str]:
        for group in ("data", "meta"):
            yield from (f"{group}/{name}" for name in sorted(self._arrays[group]))  # pyright: ignore

    def _array(self, name: str) -> zarr.Array[Any]:
        array = self._arrays[name]
        assert isinstance(array, zarr.Array)
        return array

    def _read(self, name: str, start: int, end: int) -> np.ndarray[Any, Any]:
        array = self._array(name)
        rows = (array.shards or array.chunks)[0]  # of one file
        for first in range(start // rows, (end - 1) // rows + 1):
            key = array.metadata.encode_chunk_key((first, *[0] * (array.ndim - 1)))
            if not (self._path / name / key).is_file():  # Zarr takes a missing file for zeros
                raise StageError(f"{name}: its file {key} is missing")
        try:
            return np.asarray(array[start:end])
        except Exception as error:  # whatever a decoder raises on damaged bytes
            raise StageError(f"{name} cannot be read: {error}") from error


def rescue(path: Path, dry_run: bool = False) -> None:
    """Keeps the whole episodes of a store. Raises StageError where that cannot be done."""
    beside = path.with_name(f"{path.stem}.rescued{path.suffix}")
    aside = path.with_name(f"{path.stem}.damaged{path.suffix}")
    with owned(path), TemporaryDirectory(prefix="rf_exp-") as frame:
        if beside.is_dir() and aside.is_dir() and not path.exists():  # killed between the two moves
            beside.rename(path)
            console.print(f"{path} is the rescued one now; the damaged one is {aside}")
            return
        if not path.is_dir():
            raise StageError(
                f"no store at {path}; expected the folder of one, such as outputs/data/.../quick.zarr"
            )
        damaged = Damaged(path, Path(frame))
        if not dry_run:
            if aside.exists():
                raise StageError(
                    f"{aside} is there from an earlier rescue; delete it, or move it away, first"
                )
            shutil.rmtree(beside, ignore_errors=True)  # of a rescue that was killed
        lost, kept = _copy(damaged, None if dry_run else beside)
        if not lost and _opens(path):
            shutil.rmtree(beside, ignore_errors=True)
            console.print(f"{path} is not damaged: all {len(kept)} episodes can be read")
            return
        for index, reason in lost.items():
            console.print(f"lost: episode {index}, {reason}")
        if dry_run:
            console.print(f"{len(kept)} of {len(kept) + len(lost)} episodes can be kept; nothing was changed")
            return
        assert Store.open(beside).seeds.tolist() == kept
        path.rename(aside)
        beside.rename(path)
    console.print(
        f"{path} holds the {len(kept)} whole episodes of {len(kept) + len(lost)}; the damaged one is "
        f"{aside}. The command that made the data makes the lost seeds again"
    )


def _copy(damaged: Damaged, to: Path | None) -> tuple[dict[int, str], list[int]]:
    """(episode -> why it is lost, seeds that are whole), written to a new store if one is named."""
    lost: dict[int, str] = {}
    kept: list[int] = []
    attrs, store = damaged.attrs, None
    if to is not None:
        empty_like(to, attrs)
        store = Store.open(to, writable=True)
    for index in range(len(damaged.ends)):
        try:
            episode = damaged.episode(index)
        except StageError as error:
            lost[index] = f"{_seed(damaged, index)}: {error}"
            continue
        if episode.seed in kept:
            lost[index] = f"seed {episode.seed}: it is there already"
            continue
        kept.append(episode.seed)
        if store is not None:
            store.append(episode)
    if store is not None:
        store.close()
    return lost, kept


def _seed(damaged: Damaged, index: int) -> str:
    try:
        return f"seed {damaged.seed(index)}"
    except StageError:
        return "of a seed that cannot be read"


def _opens(path: Path) -> bool:
    try:
        Store.open(path)
    except StageError:
        return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, help="folder of a damaged store")
    parser.add_argument("--dry-run", action="store_true", help="say what would be kept, and change nothing")
    given = parser.parse_args()
    rescue(given.store, given.dry_run)


if __name__ == "__main__":
    sys.exit(guarded(main))
