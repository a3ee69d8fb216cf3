"""How a training goes, as rows of a file."""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from rf_exp.artifacts import whole
from rf_exp.policy.learning.checkpoint import CURVES


@dataclass(frozen=True)
class Curve:
    """How training goes, averaged since the last one: a row of curves.csv."""

    step: int
    steps: int  # of the whole training
    epoch: int
    loss: float
    learning_rate: float
    samples_per_s: float  # windows
    core_s: float  # CPU seconds since the beginning, of all threads


@contextmanager
def curves(path: Path, step: int) -> Iterator[Callable[[Curve], None]]:
    """Appends rows to the curves; rows beyond `step`, of an interrupted run, are dropped first."""
    names = [field.name for field in fields(Curve)]
    kept: list[dict[str, Any]] = []
    if path.exists():
        with path.open(newline="") as file:
            lines = [line for line in file if line.endswith("\n")]  # the last one may be half written
        kept = [row for row in csv.DictReader(lines) if int(row["step"]) <= step]
    with whole(path) as draft, draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(kept)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, names)

        def write(curve: Curve) -> None:
            writer.writerow(asdict(curve))
            file.flush()

        yield write


def cost_s(folder: Path) -> float:
    """CPU seconds that the training of a policy took."""
    with (folder / CURVES).open(newline="") as file:
        return max((float(row["core_s"]) for row in csv.DictReader(file)), default=0.0)
