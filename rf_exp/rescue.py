"""Rescues a damaged store: copies its intact episodes to a new store and moves the damaged one aside.

python -m rf_exp.rescue outputs/data/lift_barrier/full/fast.zarr             keeps the intact episodes
python -m rf_exp.rescue outputs/data/lift_barrier/full/fast.zarr --dry-run   says which these are
"""

import argparse
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext, suppress
from itertools import count, takewhile
from pathlib import Path
from tempfile import TemporaryDirectory

from rf_exp.artifacts import atomic_path
from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError
from rf_exp.progress import console
from rf_exp.stages import artifact_lock
from rf_exp.store import Damage, DamagedStore, Store, empty_like, refuse_other_kinds


def rescue(path: Path, dry_run: bool = False) -> None:
    """Keeps the intact episodes of a store. Raises StageError where that cannot be done.

    Wherever it is killed, the damaged store remains, under its own name or the one to which it is moved.
    """
    path = path.absolute()
    if not path.name:
        raise ArgumentError(f"{path} is no store")
    rescued = path.with_name(f"{path.stem}.rescued{path.suffix}")
    if path.exists() or not rescued.is_dir():  # unless a rescue was killed between its two moves
        refuse_other_kinds(path)
    with nullcontext() if dry_run else artifact_lock(path):  # a dry run only reads, and takes no lock
        earlier = [*takewhile(Path.exists, _damaged_paths(path))]
        if rescued.is_dir() and earlier and not path.exists():  # killed between the two moves
            if not dry_run:
                rescued.rename(path)
            becomes = "would be" if dry_run else "is"
            console.print(f"{path} {becomes} the rescued one now; the damaged one is {earlier[-1]}")
            return
        if not dry_run:
            shutil.rmtree(rescued, ignore_errors=True)  # left by a rescue that was killed
        lost, kept = _copy_intact(path, None if dry_run else rescued)
        if not lost and _can_open(path):
            if not dry_run:
                shutil.rmtree(rescued, ignore_errors=True)
            console.print(f"{path} is not damaged: all {len(kept)} episodes can be read")
            return
        for index, reason in lost.items():
            console.print(f"lost: episode {index}, {reason}")
        if dry_run:
            console.print(f"{len(kept)} of {len(kept) + len(lost)} episodes can be kept; nothing was changed")
            return
        assert Store.open(rescued).seeds.tolist() == kept
        moved = next(each for each in _damaged_paths(path) if each not in earlier)
        path.rename(moved)
        rescued.rename(path)
    console.print(
        f"{path} holds the {len(kept)} whole episodes of {len(kept) + len(lost)}; the damaged one is "
        f"{moved}. The command that made the data makes the lost seeds again"
    )


def _damaged_paths(path: Path) -> Iterator[Path]:
    """Yields the paths to which damaged stores are moved, in order; an existing one is never overwritten."""
    numbers = ("" if number == 1 else f"-{number}" for number in count(1))
    return (path.with_name(f"{path.stem}.damaged{number}{path.suffix}") for number in numbers)


def _copy_intact(path: Path, target: Path | None) -> tuple[dict[int, str], list[int]]:
    """(lost episode -> reason, seeds of intact episodes); copies intact ones to a new store at `target`."""
    lost: dict[int, str] = {}
    kept: list[int] = []
    with ExitStack() as stack:
        damaged = DamagedStore(path, Path(stack.enter_context(TemporaryDirectory(prefix="rf_exp-"))))
        store = None
        if target is not None:
            draft = stack.enter_context(atomic_path(target))
            empty_like(draft, damaged.attrs)
            store = stack.enter_context(Store.open(draft, writable=True))
        for index in range(len(damaged.ends)):
            try:
                episode = damaged.episode(index)
            except Damage as error:
                episode_name = "of a seed that cannot be read"
                with suppress(Damage):
                    episode_name = f"seed {damaged.seed(index)}"
                lost[index] = f"{episode_name}: {error}"
                continue
            if episode.seed in kept:
                lost[index] = f"seed {episode.seed}: it is there already"
                continue
            kept.append(episode.seed)
            if store is not None:
                store.append(episode)
    return lost, kept


def _can_open(path: Path) -> bool:
    try:
        Store.open(path)
    except Damage:
        return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m rf_exp.rescue", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, help="folder of a damaged store")
    parser.add_argument("--dry-run", action="store_true", help="say what would be kept, and change nothing")
    arguments = parser.parse_args()
    rescue(arguments.store, arguments.dry_run)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
