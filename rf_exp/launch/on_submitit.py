"""submitit: a job of Slurm for each of ours; or, for a try, processes of this machine that act like it."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from submitit import AutoExecutor

from rf_exp.errors import ArgumentError
from rf_exp.launch.running import Submit, on_node
from rf_exp.launch.spec import Launch

TIMEOUT_MIN = 240  # unless options say otherwise; submitit's own is 5


@contextmanager
def connected(launch: Launch, at_once: int, folder: Path) -> Iterator[Submit]:
    """Within, jobs go to Slurm; scripts and what jobs print are in `folder`.

    Jobs outlive this command: only one that is told to end cancels them. Raises ArgumentError where there is
    no Slurm, and for options that it does not have.
    """
    try:
        executor = AutoExecutor(folder / "submitit", cluster=launch.address)
        executor.update_parameters(**{"name": "rf_exp", "timeout_min": TIMEOUT_MIN, **(launch.options or {})})
    except (RuntimeError, ValueError, NameError, AssertionError, TypeError) as error:
        raise ArgumentError(f"launch.address={launch.address}, launch.options: {error}") from error
    yield partial(executor.submit, on_node)
