"""Publishes measured rows to results/; those of policies with their provenance and training curves.

    python scripts/publish.py outputs/benchmark [--scenes 100]
    python scripts/publish.py outputs/expert --demonstrations expert
    python scripts/publish.py outputs/brains --demonstrations brains

Afterwards `python docs/policies.py` and `python docs/tables.py` write the pages. A training seed with all its
scenes replaces the same one in results/; others there are kept if they were evaluated in the same way. Rows
of demonstrations replace all rows of their file. Each file is written whole: if this is killed, no rows are
without their provenance, and the same command completes the rest.
"""

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from statistics import fmean

from rf_exp.ablation import (
    PUBLISHED,
    EvaluationRow,
    GenerationRow,
    Published,
    read_curves,
    read_published,
    read_rows,
    training_seed_file,
    write_published,
)
from rf_exp.artifacts import configuration_file, read_json
from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError
from rf_exp.findings import Dialogue
from rf_exp.progress import console

RESULTS = Path(__file__).parents[1] / "results"
CURVE_STEPS = 200  # training steps per row of published curves
REMEDY = "evaluate again (stages=[evaluate])"


def publish(out: Path, results: Path, scenes: int) -> None:
    """Publishes all finished training seeds below `out/results/evaluate`.

    Raises ArgumentError where there are no rows.
    """
    for path in _files(out, "evaluate/*/*"):
        rows = read_rows(path, EvaluationRow)
        finished = [seed for seed in _seeds(rows) if sum(r.train_seed == seed for r in rows) >= scenes]
        target = (results / path.relative_to(out / "results")).with_suffix(PUBLISHED)
        if finished:
            # The draws of a scene follow from its seed, and would be most of the bytes.
            published = [replace(row, drawn={}) for row in rows if row.train_seed in finished]
            other_seeds = _merge(out, path, target, published)
            console.print(
                f"{target}: training seeds {finished}" + (f", beside {other_seeds}" if other_seeds else "")
            )
        for seed in _seeds(rows) - {*finished}:
            console.print(f"{target}: training seed {seed} is not finished, nothing of it is published")


def publish_demonstrations(out: Path, results: Path, kind: str) -> None:
    """Publishes rows below `out/results/generate`: those under `full` for `expert`, else all.

    Raises ArgumentError where there are none.
    """
    for path in _files(out, "generate/*"):
        task, constraints = path.parent.name, path.stem
        if kind == "expert" and constraints != "full":
            continue
        target = (
            results
            / kind
            / (f"{task}{PUBLISHED}" if kind == "expert" else f"{task}/{constraints}{PUBLISHED}")
        )
        rows = read_rows(path, GenerationRow)
        if kind != "brains":  # the dialogues would be most of the bytes
            rows = tuple(replace(row, dialogue=Dialogue()) for row in rows)
        write_published(target, Published(rows))
        console.print(str(target))


def _files(out: Path, folders: str) -> list[Path]:
    if not (files := sorted(out.glob(f"results/{folders}/*.jsonl"))):
        raise ArgumentError(
            f"no rows below {out}/results/{folders.partition('/')[0]}; expected the `out` of a run"
        )
    return files


def _seeds(rows: Iterable[EvaluationRow]) -> set[int]:
    return {row.train_seed for row in rows}


def _merge(out: Path, path: Path, target: Path, rows: list[EvaluationRow]) -> list[int]:
    """Writes rows with provenance and curves; returns the training seeds that are kept beside them."""
    configuration = read_json(configuration_file(path), REMEDY)
    existing = read_published(target, EvaluationRow) if target.exists() else Published(())
    if existing.asked != configuration:
        existing = Published(())  # evaluated differently, or in an unknown way: shares no cell with these
    seeds = _seeds(rows)
    kept = [row for row in existing.rows if row.train_seed not in seeds]
    provenances, curves = (
        dict(existing.made),
        {seed: each for seed, each in existing.curves.items() if seed not in seeds},
    )
    for seed in seeds:
        provenances[seed] = read_json(configuration_file(training_seed_file(path, seed)), REMEDY)
        if seed_curves := _curves(out, rows[0], seed):
            curves[seed] = seed_curves
    ordered = sorted([*kept, *rows], key=lambda row: (row.train_seed, row.scene_seed))
    by_seed = (dict(sorted(each.items())) for each in (provenances, curves))
    write_published(target, Published(tuple(ordered), configuration, *by_seed))
    return sorted(_seeds(kept))


def _curves(out: Path, row: EvaluationRow, seed: int) -> dict[str, dict[str, list[float]]]:
    """Policy -> curve: mean loss of every CURVE_STEPS steps; empty if this recipe has trained no policy."""
    folder = out / "policies" / row.task / row.constraints / row.arch
    curves: dict[str, dict[str, list[float]]] = {}
    for path in [] if row.shield else sorted(folder.glob(f"{row.recipe}-{row.demos}-{seed}/*/curves.csv")):
        log = read_curves(path)
        rows = zip(log["step"], log["loss"], log["core_s"], strict=True)
        curve = curves[path.parent.name] = {"step": [], "loss": [], "core_s": []}
        for _, chunk in groupby(rows, lambda row: (row[0] - 1) // CURVE_STEPS):
            steps, losses, spent_s = zip(*chunk, strict=True)
            curve["step"].append(round(steps[-1]))
            curve["loss"].append(float(f"{fmean(losses):.4g}"))
            curve["core_s"].append(float(f"{spent_s[-1]:g}"))
    return curves


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="of the runs, such as outputs/benchmark")
    parser.add_argument("--scenes", type=int, default=100, help="that a training seed must have (100)")
    parser.add_argument(
        "--demonstrations",
        choices=("expert", "ablation", "brains"),
        help="rows of demonstrations instead, and of what",
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="where to (results/)")
    arguments = parser.parse_args()
    if arguments.demonstrations:
        publish_demonstrations(arguments.out, arguments.results, arguments.demonstrations)
    else:
        publish(arguments.out, arguments.results, arguments.scenes)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
