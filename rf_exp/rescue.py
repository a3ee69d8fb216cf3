"""What can be kept of a damaged store: its whole episodes, in a new one. The damaged one is moved aside.

python -m rf_exp.rescue outputs/data/lift_barrier/full/fast.zarr             keeps what is whole
python -m rf_exp.rescue outputs/data/lift_barrier/full/fast.zarr --dry-run   says what that is
"""

import argparse
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rf_exp.command import guarded
from rf_exp.errors import StageError
from rf_exp.progress import console
from rf_exp.stages import owned
from rf_exp.store import Damaged, Store, empty_like


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
                f"no store at {path}; expected the folder of one, such as outputs/data/.../fast.zarr"
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
        "python -m rf_exp.rescue", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, help="folder of a damaged store")
    parser.add_argument("--dry-run", action="store_true", help="say what would be kept, and change nothing")
    given = parser.parse_args()
    rescue(given.store, given.dry_run)


if __name__ == "__main__":
    sys.exit(guarded(main))
