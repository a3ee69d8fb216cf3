"""submitit: a job of Slurm for each of ours; or, for a try, processes of this machine that act like it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import current_thread, main_thread

from submitit import AutoExecutor

from rf_exp.errors import ArgumentError
from rf_exp.launch.running import Handle, Job, Submit, on_node
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

    def submit(job: Job) -> Handle:
        with _heeding_interrupts():
            return executor.submit(on_node, job)

    yield submit


@contextmanager
def _heeding_interrupts() -> Iterator[None]:
    """Processes begun within end at SIGINT, by which submitit cancels them on this machine.

    Where this one ignores it, as in the background of a shell's script, they would ignore it as well.
    """
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN and current_thread() is main_thread()
    if ignored:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        if ignored:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
