"""Verification of published rows of demonstrations: generates them again and compares the results."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rf_exp.ablation import GenerationRow, read_published, read_rows
from rf_exp.errors import ArgumentError, StageError
from rf_exp.tasks import ASSETS, CAMERAS, parted, unmarked
from rf_exp.texts import one_line

EXPERIMENTS = ("ablation",)  # experiments whose rows lie in a folder of that name
COMPARED = ("success", "success_paper", "steps", "attempts", "violations", "contacts")
FEW = {"workers": 1, "render": "false", "recordings": 0, "wandb": "disabled"}  # these change no row


def published(path: Path, seeds: int) -> tuple[GenerationRow, ...]:
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
            "evaluate first_scene=... scenes=10 with rf_exp.run; rows of demonstrations can be made again"
        ) from error
    rows = tuple(sorted(rows, key=lambda row: row.seed))[:seeds]
    if (first := rows[0]).brain != "scripted":
        raise ArgumentError(f"{path} holds rows of brain={first.brain}, which need not say the same again")
    return tuple(row for row in rows if row.seed < first.seed + len(rows))


def made_again(
    rows: Sequence[GenerationRow], out: Path, experiment: str | None = None
) -> tuple[GenerationRow, ...]:
    """Generates the same seeds in a new process; `experiment` is one with scenes of its own.

    Raises ArgumentError for scenes with the release's assets, StageError where generation fails.
    """
    row = rows[0]
    name, marks = unmarked(row.task)
    if ASSETS in marks:
        raise ArgumentError(f"rows of {row.task} are of scenes with the release's assets, which are not here")
    task, robots = parted(name)
    asked = {
        **({"cameras_of": "release"} if CAMERAS in marks else {}),
        **({"experiment": experiment} if experiment else {}),
        **({"robot": f"[{','.join(robots)}]"} if robots else {}),
        **{"task": task, "constraints": row.constraints, "seed": row.seed, "episodes": len(rows)},
        **{"disturbance_rad": row.disturbance_rad, "delay_s": row.delay_s},
        **{"variation": row.variation, "out": out, **FEW},
    }
    command = [sys.executable, "-m", "rf_exp.run", "stages=[generate]"]
    command += [f"{key}={value}" for key, value in asked.items()]
    done = subprocess.run(command, capture_output=True, text=True)
    files = sorted((out / "results" / "generate" / row.task).glob("*.jsonl"))
    if done.returncode and not files:  # there are rows even where no seed succeeds
        raise StageError(one_line(done.stderr.strip().rpartition("\n")[2] or "the run said nothing"))
    return read_rows(files[0], GenerationRow)


def differences(rows: Sequence[GenerationRow], again: Sequence[GenerationRow]) -> Iterator[str]:
    """Differences between published and regenerated rows, seed by seed."""
    found = {row.seed: row for row in again}
    for row in rows:
        if (other := found.get(row.seed)) is None:
            yield f"seed {row.seed}: nothing came out"
            continue
        for name in COMPARED:
            if (told := getattr(row, name)) != (came := getattr(other, name)):
                yield f"seed {row.seed}: {name} is told as {told}, and came out as {came}"
