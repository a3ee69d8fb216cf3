"""Commands that write, killed before each of their writes: nothing torn, and the same bytes after it.

`benchmarks/writes.py` does this with real data, at every write and at random moments.
"""

import runpy
import shutil
from pathlib import Path
from typing import Any

import pytest

from rf_exp.ablation import EvaluationRow, read_published
from rf_exp.data.__main__ import export, merge_stores
from rf_exp.data.importing import import_demonstrations
from rf_exp.rescue import rescue
from tests.ablation.test_publish import CELL, measured, publish, won
from tests.data.release_files import made, raw
from tests.store.episodes import make_episode, make_store
from tests.test_data import store_of

BENCHMARK = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "writes.py"))
Command, killed = BENCHMARK["Command"], BENCHMARK["killed"]


def assert_right(command: Any, folder: Path, every: int = 1, last: int | None = None) -> None:
    """All is right when the command is killed before every so many of its writes, or of the last."""
    trials = killed(command, folder, every, last)
    assert trials.kills and not trials.defects, "\n".join(trials.defects)


@pytest.mark.slow
def test_a_merge_that_is_killed_has_its_card_or_no_store(tmp_path: Path) -> None:
    parts = [make_store(tmp_path / f"{seed}.zarr", [make_episode(seed, cameras=())], ()) for seed in (0, 1)]
    command = Command(
        run=lambda out: merge_stores(parts, out / "merged.zarr"),
        inputs=tuple(parts),
        atomic_outputs=("merged.zarr", "merged.md"),
        other_defects=lambda out: (
            "no card" if (out / "merged.zarr").exists() > (out / "merged.md").exists() else ""
        ),
    )
    assert_right(command, tmp_path / "trials", every=2, last=8)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["lerobot", "robomimic", "robofactory", "recordepisode"])
def test_an_export_that_is_killed_is_there_as_a_whole_or_not_at_all(tmp_path: Path, form: str) -> None:
    store = store_of(tmp_path / "s.zarr", range(1))
    command = Command(
        run=lambda out: export(store, out / "export", form), inputs=(store,), atomic_outputs=("export",)
    )
    assert_right(command, tmp_path / "trials", every=2, last=5)


@pytest.mark.slow
def test_an_import_that_is_killed_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    """Of what is stored already it keeps every episode; the card comes last."""
    source = raw(tmp_path / "source/x.h5", [made(seed, 3) for seed in (4, 5)])
    command = Command(
        run=lambda out: import_demonstrations([source], out / "s.zarr", "lift_barrier"),
        inputs=(source,),
        atomic_outputs=("s.md",),
    )
    assert_right(command, tmp_path / "trials", every=60)


@pytest.mark.slow
def test_a_rescue_that_is_killed_leaves_the_damaged_store_whole(tmp_path: Path) -> None:
    store = make_store(tmp_path / "s.zarr", [make_episode(seed, cameras=()) for seed in (0, 1)], ())
    (store / "meta/seed/zarr.json").write_text("{")
    original = BENCHMARK["content"](store)

    def lost(out: Path) -> str:
        there = [BENCHMARK["content"](each) for each in out.glob("q*.zarr")]
        return "" if original in there else "the damaged store is nowhere"

    command = Command(
        run=lambda out: rescue(out / "q.zarr"),
        prepare=lambda out: shutil.copytree(store, out / "q.zarr"),
        inputs=(store,),
        other_defects=lost,
    )
    assert_right(command, tmp_path / "trials", every=2, last=12)


@pytest.mark.slow
@pytest.mark.parametrize("alike", [True, False])
def test_a_publication_that_is_killed_shows_rows_only_beside_what_they_were_made_of(
    tmp_path: Path, alike: bool
) -> None:
    """The training seeds 0 and 1 are there; 1 and 2 come, evaluated alike or otherwise."""
    runs = {"first": ((0, 1), (1, 2)), "later": ((1, 3), (2, 4))}  # of training seeds, and their successes
    for name, seeds in runs.items():
        for seed, wins in seeds:
            measured(tmp_path / name, seed, wins, steps=100 if alike or name == "first" else 120)
    publish(tmp_path / "first", tmp_path / "before")

    def unlike(results: Path) -> str:
        """A file of rows says how each training seed was made, and how all were evaluated."""
        if not (results / CELL).exists():
            return "no rows"
        there = read_published(results / CELL, EvaluationRow)
        if there.made.keys() != won(results).keys():
            return "there are training seeds without rows, or rows without what they were made of"
        for seed, wins in won(results).items():
            of = next(name for name, seeds in runs.items() if (seed, wins) in seeds)
            steps = 100 if alike or of == "first" else 120
            if (there.made[seed], there.asked) != ({"of": wins}, {"step_limit": steps}):
                return f"training seed {seed} is not beside what it was made of"
        return ""

    command = Command(
        run=lambda out: publish(tmp_path / "later", out / "results"),
        prepare=lambda out: shutil.copytree(tmp_path / "before", out / "results"),
        inputs=(tmp_path / "later",),
        atomic_outputs=(str("results" / CELL),),
        other_defects=lambda out: unlike(out / "results"),
    )
    assert_right(command, tmp_path / "trials")
