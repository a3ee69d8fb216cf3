"""Training curves: followed while other processes write them, and sent to Weights & Biases."""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from rf_exp.experiment import Experiment
from rf_exp.policy.train import Curve


@contextmanager
def curve_log(experiment: Experiment, title: str) -> Iterator[Callable[[Curve], None]]:
    """A function that logs a row of the training curves of one policy."""
    if experiment.wandb == "disabled":
        yield lambda curve: None
        return
    import wandb  # slow to import, and not needed by those who switch it off

    config = {"policy": asdict(experiment.policy), "training": asdict(experiment.training)}
    run = None

    def log(curve: Curve) -> None:
        nonlocal run
        if run is None:  # a policy that is there already logs nothing, so it gets no run
            folder = experiment.out / "wandb"
            folder.mkdir(parents=True, exist_ok=True)
            settings = wandb.Settings(silent=True)
            run = wandb.init(
                project="rf_exp",
                name=title,
                dir=folder,
                mode=experiment.wandb,
                config=config,
                settings=settings,
                reinit="create_new",  # policies that train side by side have runs of their own
            )
        run.log(asdict(curve), step=curve.step)

    try:
        yield log
    finally:
        if run is not None:
            run.finish()


class Follower:
    """Reads the curves of a policy while another process trains it; hands every new row to `log`."""

    def __init__(self, path: Path, log: Callable[[Curve], None]) -> None:
        self._path, self._log, self._step = path, log, 0
        self._step = max((curve.step for curve in self._rows()), default=0)  # an earlier run's are old

    def new(self) -> Iterator[tuple[Curve, int]]:
        """The rows that have come since the last call, each with the steps since the row before it."""
        for curve in self._rows():
            steps, self._step = curve.step - self._step, curve.step
            self._log(curve)
            yield curve, steps

    def _rows(self) -> list[Curve]:
        if not self._path.exists():
            return []
        with self._path.open(newline="") as file:
            whole = [line for line in file if line.endswith("\n")]  # the last one may be half written
        kinds: dict[str, Any] = {field.name: field.type for field in fields(Curve)}
        rows = (
            Curve(**{name: kinds[name](value) for name, value in row.items()})
            for row in csv.DictReader(whole)
        )
        return [row for row in rows if row.step > self._step]
