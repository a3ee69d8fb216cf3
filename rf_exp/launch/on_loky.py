"""joblib's loky: processes of this machine that end with the command."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from joblib.externals.loky import get_reusable_executor

from rf_exp.launch.running import Submit, on_node
from rf_exp.launch.spec import Launch
from rf_exp.processes import end_with_parent
from rf_exp.progress import console

IDLE_S = 300  # after which a process without a job ends


@contextmanager
def connected(launch: Launch, at_once: int, folder: Path) -> Iterator[Submit]:
    """Within, as many processes as jobs at a time. When some died there are new ones for the next job."""
    executor = partial(get_reusable_executor, max_workers=at_once, timeout=IDLE_S, initializer=_begin)
    try:
        yield lambda job: executor().submit(on_node, job)
    finally:
        executor().shutdown(wait=True, kill_workers=True)


def _begin() -> None:
    """A new process: its parent speaks for it, and Ctrl-C is its parent's affair."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console.quiet = True
