"""Training curves: curves.csv in the folder of a policy."""

import csv
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from rf_exp.artifacts import atomic_path

CURVES = "curves.csv"


@dataclass(frozen=True)
class Curve:
    """One row of curves.csv; loss and speed are averages since the last row."""

    step: int
    steps: int  # of the whole training
    epoch: int
    loss: float
    learning_rate: float
    samples_per_s: float  # windows
    core_s: float  # CPU seconds since the beginning, of all threads


COLUMN_TYPES: dict[str, Any] = {each.name: each.type for each in fields(Curve)}


def read_curves(path: Path) -> list[Curve]:
    """The complete rows of a file, also during training. Raises FileNotFoundError."""
    with path.open(newline="") as file:
        lines = [line for line in file if line.endswith("\n")]  # the last one may be half written
    return [
        Curve(**{name: COLUMN_TYPES[name](row[name]) for name in COLUMN_TYPES})
        for row in csv.DictReader(lines)
    ]


def begin_curves(path: Path, step: int) -> None:
    """Start a file with the rows up to `step`: later ones are of an interrupted run."""
    earlier = [curve for curve in read_curves(path) if curve.step <= step] if path.exists() else []
    with atomic_path(path) as draft, draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMN_TYPES)
        writer.writeheader()
        writer.writerows(asdict(curve) for curve in earlier)


def cost_s(folder: Path) -> float:
    """CPU seconds that the training of a policy took."""
    return max((curve.core_s for curve in read_curves(folder / CURVES)), default=0.0)
