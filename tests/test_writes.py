"""Commands killed before their writes: no incomplete files, and the same bytes after running them again.

`benchmarks/writes.py` repeats this with real data, at every write and at random moments.
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
from tests.data.release_files import source_episode, write_raw
from tests.store.episodes import make_episode, make_store
from tests.test_data import store_of

BENCHMARK = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "writes.py"))
Command, run_killed = BENCHMARK["Command"], BENCHMARK["killed"]


def assert_no_defects(command: Any, folder: Path, every: int = 1, last: int | None = None) -> None:
    """Kills the command before every `every`-th of its (`last`) writes, and expects no defects."""
    trials = run_killed(command, folder, every, last)
    assert trials.kills and not trials.defects, "\n".join(trials.defects)


@pytest.mark.slow
def test_a_killed_merge_leaves_no_store_without_a_card(tmp_path: Path) -> None:
    parts = [make_store(tmp_path / f"{seed}.zarr", [make_episode(seed, cameras=())], ()) for seed in (0, 1)]
    command = Command(
        run=lambda out: merge_stores(parts, out / "merged.zarr"),
        inputs=tuple(parts),
        atomic_outputs=("merged.zarr", "merged.md"),
        other_defects=lambda out: (
            "no card" if (out / "merged.zarr").exists() > (out / "merged.md").exists() else ""
        ),
    )
    assert_no_defects(command, tmp_path / "trials", every=2, last=8)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["lerobot", "robomimic", "robofactory", "recordepisode"])
def test_a_killed_export_is_complete_or_absent(tmp_path: Path, form: str) -> None:
    store = store_of(tmp_path / "s.zarr", range(1))
    command = Command(
        run=lambda out: export(store, out / "export", form), inputs=(store,), atomic_outputs=("export",)
    )
    assert_no_defects(command, tmp_path / "trials", every=2, last=5)


@pytest.mark.slow
def test_an_import_resumed_after_a_kill_gives_the_same_bytes(tmp_path: Path) -> None:
    """Stored episodes are kept; the card is written last."""
    source = write_raw(tmp_path / "source/x.h5", [source_episode(seed, 3) for seed in (4, 5)])
    command = Command(
        run=lambda out: import_demonstrations([source], out / "s.zarr", "lift_barrier"),
        inputs=(source,),
        atomic_outputs=("s.md",),
    )
    assert_no_defects(command, tmp_path / "trials", every=60)


@pytest.mark.slow
def test_a_killed_rescue_leaves_the_damaged_store_unchanged(tmp_path: Path) -> None:
    store = make_store(tmp_path / "s.zarr", [make_episode(seed, cameras=()) for seed in (0, 1)], ())
    (store / "meta/seed/zarr.json").write_text("{")
    original = BENCHMARK["content"](store)

    def missing_original(out: Path) -> str:
        stores = [BENCHMARK["content"](each) for each in out.glob("q*.zarr")]
        return "" if original in stores else "the damaged store is nowhere"

    command = Command(
        run=lambda out: rescue(out / "q.zarr"),
        prepare=lambda out: shutil.copytree(store, out / "q.zarr"),
        inputs=(store,),
        other_defects=missing_original,
    )
    assert_no_defects(command, tmp_path / "trials", every=2, last=12)


@pytest.mark.slow
@pytest.mark.parametrize("same_settings", [True, False])
def test_a_killed_publication_keeps_rows_and_provenance_consistent(
    tmp_path: Path, same_settings: bool
) -> None:
    """Training seeds 0 and 1 are published; 1 and 2 are added, evaluated in the same or in another way."""
    runs = {"first": ((0, 1), (1, 2)), "later": ((1, 3), (2, 4))}  # (training seed, successes)
    for name, seeds in runs.items():
        for seed, wins in seeds:
            measured(tmp_path / name, seed, wins, steps=100 if same_settings or name == "first" else 120)
    publish(tmp_path / "first", tmp_path / "before")

    def mismatch(results: Path) -> str:
        """A mismatch between published rows and the provenance of their training seeds; empty if none."""
        if not (results / CELL).exists():
            return "no rows"
        published = read_published(results / CELL, EvaluationRow)
        if published.made.keys() != won(results).keys():
            return "there are training seeds without rows, or rows without what they were made of"
        for seed, wins in won(results).items():
            source = next(name for name, seeds in runs.items() if (seed, wins) in seeds)
            steps = 100 if same_settings or source == "first" else 120
            if (published.made[seed], published.asked) != ({"of": wins}, {"step_limit": steps}):
                return f"training seed {seed} is not beside what it was made of"
        return ""

    command = Command(
        run=lambda out: publish(tmp_path / "later", out / "results"),
        prepare=lambda out: shutil.copytree(tmp_path / "before", out / "results"),
        inputs=(tmp_path / "later",),
        atomic_outputs=(str("results" / CELL),),
        other_defects=lambda out: mismatch(out / "results"),
    )
    assert_no_defects(command, tmp_path / "trials")
