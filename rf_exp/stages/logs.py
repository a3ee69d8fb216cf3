"""Training curves to Weights & Biases, offline unless asked otherwise."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict

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
            )
        run.log(asdict(curve), step=curve.step)

    try:
        yield log
    finally:
        if run is not None:
            run.finish()
