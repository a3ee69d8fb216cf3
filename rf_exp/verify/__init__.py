"""Verification of published rows of demonstrations: generates them again and compares the results."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rf_exp.ablation import GenerationRow, read_published, read_rows
from rf_exp.errors import ArgumentError, StageError
from rf_exp.tasks import RELEASE_ASSETS, RELEASE_CAMERAS, split_marks, split_robots
from rf_exp.texts import one_line

EXPERIMENTS = ("ablation",)  # experiments whose rows lie in a folder of that name
COMPARED = ("success", "success_paper", "steps", "attempts", "violations", "contacts")
FAST_OPTIONS = {"workers": 1, "render": "false", "recordings": 0, "wandb": "disabled"}  # these change no row


def read_published_rows(path: Path, seeds: int) -> tuple[GenerationRow, ...]:
    """The first `seeds` rows of a published file.

    Raises ArgumentError for rows of policies, whose weights are not published, for rows of a brain other than
    `scripted`, for a missing file, and for fewer than one row.
    """
    if seeds < 1:
        raise ArgumentError(f"--seeds is {seeds}; expected 1 or more")
    if not path.is_file():
        raise ArgumentError(f"there is no file {path}; published rows are results/**/*.tsv")
    try:
        rows = read_published(path, GenerationRow).rows
    except (ArgumentError, StageError) as error:
        if "EvaluationRow" not in path.read_text("utf-8").partition("\n")[0]:
            raise
        raise ArgumentError(
            f"{path} holds rows of policies, whose weights are not among the results: learn them, "
            "evaluate first_scene=... scenes=10 with rf_exp.run; rows of demonstrations can be regenerated"
        ) from error
    rows = tuple(sorted(rows, key=lambda row: row.seed))[:seeds]
    if (first := rows[0]).brain != "scripted":
        raise ArgumentError(f"{path} holds rows of brain={first.brain}, whose answers may differ")
    return tuple(row for row in rows if row.seed < first.seed + len(rows))


def regenerate(
    rows: Sequence[GenerationRow], out: Path, experiment: str | None = None
) -> tuple[GenerationRow, ...]:
    """Generates the same seeds in a new process; `experiment` is one with scenes of its own.

    Raises ArgumentError for scenes with the release's assets, StageError where generation fails.
    """
    row = rows[0]
    name, marks = split_marks(row.task)
    if RELEASE_ASSETS in marks:
        raise ArgumentError(f"rows of {row.task} are of scenes with the release's assets, which are not here")
    task, robots = split_robots(name)
    overrides = {
        **({"cameras_of": "release"} if RELEASE_CAMERAS in marks else {}),
        **({"experiment": experiment} if experiment else {}),
        **({"robot": f"[{','.join(robots)}]"} if robots else {}),
        **{"task": task, "constraints": row.constraints, "seed": row.seed, "episodes": len(rows)},
        **{"disturbance_rad": row.disturbance_rad, "delay_s": row.delay_s},
        **{"variation": row.variation, "out": out, **FAST_OPTIONS},
    }
    command = [sys.executable, "-m", "rf_exp.run", "stages=[generate]"]
    command += [f"{key}={value}" for key, value in overrides.items()]
    process = subprocess.run(command, capture_output=True, text=True)
    files = sorted((out / "results" / "generate" / row.task).glob("*.jsonl"))
    if process.returncode and not files:  # there are rows even where no seed succeeds
        raise StageError(one_line(process.stderr.strip().rpartition("\n")[2] or "the run printed no error"))
    return read_rows(files[0], GenerationRow)


def differences(rows: Sequence[GenerationRow], regenerated: Sequence[GenerationRow]) -> Iterator[str]:
    """Differences between published and regenerated rows, seed by seed."""
    rows_by_seed = {row.seed: row for row in regenerated}
    for row in rows:
        if (other := rows_by_seed.get(row.seed)) is None:
            yield f"seed {row.seed}: no row was regenerated"
            continue
        for name in COMPARED:
            if (expected := getattr(row, name)) != (actual := getattr(other, name)):
                yield f"seed {row.seed}: {name} is {expected} as published, {actual} as regenerated"
