"""Puts measured policies into results/: rows, what they were made of, and how they learned.

    python scripts/publish.py outputs/benchmark [--scenes 100]

Then `python docs/policies.py` and `python docs/tables.py` write the pages. A training seed that has all its
scenes takes the place of the same one in results/; others there stay as long as they were evaluated alike.
"""

import argparse
import csv
import shutil
import sys
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from statistics import fmean

from rf_exp.ablation import EvaluationRow, append_row, of_training_seed, read_curves, read_rows
from rf_exp.artifacts import configuration_file, read_json, whole
from rf_exp.command import guarded
from rf_exp.errors import ArgumentError
from rf_exp.progress import console

RESULTS = Path(__file__).parents[1] / "results"
EVERY = 200  # steps of learning to a row of published curves
REMEDY = "evaluate again (stages=[evaluate])"


def publish(out: Path, results: Path, scenes: int) -> None:
    """Every finished training seed below `out/results/evaluate`. Raises ArgumentError where there is none."""
    if not (files := sorted(out.glob("results/evaluate/*/*/*.jsonl"))):
        raise ArgumentError(f"no rows of policies below {out}/results/evaluate; expected the `out` of a run")
    for path in files:
        rows = read_rows(path, EvaluationRow)
        finished = [seed for seed in _seeds(rows) if sum(r.train_seed == seed for r in rows) >= scenes]
        to = results / path.relative_to(out / "results")
        if finished:
            kept = _replace(out, path, to, [row for row in rows if row.train_seed in finished])
            console.print(f"{to}: training seeds {finished}" + (f", beside {kept}" if kept else ""))
        for seed in _seeds(rows) - {*finished}:
            console.print(f"{to}: training seed {seed} is not finished, nothing of it is published")


def _seeds(rows: Iterable[EvaluationRow]) -> set[int]:
    return {row.train_seed for row in rows}


def _replace(out: Path, path: Path, to: Path, rows: list[EvaluationRow]) -> list[int]:
    """Write rows and what belongs beside them; returns the training seeds that stay there.

    The rows that go are the first that go, and the new ones come last: whenever this is killed, rows are
    there only beside what they were made of, and the same command ends as if nothing had happened.
    """
    asked, there = configuration_file(path), configuration_file(to)
    before: list[EvaluationRow] = []
    if to.exists() and there.exists() and read_json(there, REMEDY) == read_json(asked, REMEDY):
        before = [row for row in read_rows(to, EvaluationRow) if row.train_seed not in _seeds(rows)]
    # Else what is there was evaluated otherwise, or nobody knows how: it shares no cell with these.
    _write_rows(to, before)
    for old in to.parent.glob(f"{to.stem}-[0-9]*.*"):
        if not old.name.startswith(tuple(f"{to.stem}-{seed}." for seed in _seeds(before))):
            old.unlink()
    _copy(asked, there)
    for seed in _seeds(rows):
        _copy(*(configuration_file(of_training_seed(each, seed)) for each in (path, to)))
        _curves(out, rows[0], to, seed)
    _write_rows(to, [*before, *rows])
    return sorted(_seeds(before))


def _write_rows(to: Path, rows: list[EvaluationRow]) -> None:
    """The rows of a file, and no others; no file without any."""
    if not rows:
        to.unlink(missing_ok=True)
        return
    with whole(to) as draft:
        for row in sorted(rows, key=lambda row: (row.train_seed, row.scene_seed)):
            append_row(draft, row)


def _copy(path: Path, to: Path) -> None:
    with whole(to) as draft:
        shutil.copyfile(path, draft)


def _curves(out: Path, row: EvaluationRow, to: Path, seed: int) -> None:
    """The mean loss of every EVERY steps of all policies, where this recipe has learned any."""
    folder = out / "policies" / row.task / row.constraints / row.arch
    found = sorted(folder.glob(f"{row.recipe}-{row.demos}-{seed}/*/curves.csv"))
    if not found or row.shield:
        return
    with (
        whole(of_training_seed(to, seed).with_suffix(".curves.csv")) as draft,
        draft.open("w", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("policy", "step", "loss", "core_s"))
        for policy in found:
            logged = read_curves(policy)
            rows = zip(logged["step"], logged["loss"], logged["core_s"], strict=True)
            for _, of in groupby(rows, lambda row: (row[0] - 1) // EVERY):
                steps, losses, spent_s = zip(*of, strict=True)
                loss = fmean(losses)
                writer.writerow((policy.parent.name, f"{steps[-1]:.0f}", f"{loss:.4g}", f"{spent_s[-1]:g}"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="of the runs, such as outputs/benchmark")
    parser.add_argument("--scenes", type=int, default=100, help="that a training seed must have (100)")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where to (results/)")
    arguments = parser.parse_args()
    publish(arguments.out, arguments.results, arguments.scenes)


if __name__ == "__main__":
    sys.exit(guarded(main))
