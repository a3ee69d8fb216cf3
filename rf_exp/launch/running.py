"""Jobs on an engine: results in the order of the jobs, and retries after a worker's death."""

import time
from collections import deque
from collections.abc import Generator, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from rf_exp.errors import StageError, WorkerDied
from rf_exp.launch.engines import CONNECTORS, ENGINES, Handle, Job, Launch, Submit
from rf_exp.processes import Timeout, in_order

MAX_TRIES = 3  # at a job whose worker dies
MAX_AHEAD = 4  # jobs, per concurrent one, that may be begun before an earlier one is done
POLL_S = 0.1


def results(
    launch: Launch, jobs: Iterable[Job], max_parallel: int, folder: Path
) -> Generator[Any, None, None]:
    """Yields the results of the jobs in their order; at most `max_parallel` are submitted at a time.

    Jobs are pickled, so their functions have to be importable by name. `folder`, on a file system that all
    machines share, is for files of the engine. If the caller stops early, the remaining jobs are cancelled.

    Raises what a job raises, and StageError where no engine answers or a job has lost its worker three times.
    """
    if ENGINES[launch.engine].network:
        # Tried in a process that can be killed: clients wait forever for a server that is no engine.
        (probe,) = in_order([partial(_probe, launch, folder)], 1, 2 * launch.connect_s)
        if isinstance(probe, Timeout):
            raise StageError(f"launch.address={launch.address}: no {launch.engine} answers there: {probe}")
    with CONNECTORS[launch.engine](launch, max_parallel, folder) as submit:
        waiting = iter(jobs)
        submitted: deque[_RetriedJob] = deque()
        try:
            while True:
                while (
                    len(submitted) < MAX_AHEAD * max_parallel
                    and sum(not each.done() for each in submitted) < max_parallel
                ):
                    if (job := next(waiting, None)) is None:
                        break
                    submitted.append(_RetriedJob(submit, job))
                if not submitted:
                    return
                if submitted[0].done():
                    yield submitted.popleft().result
                else:
                    time.sleep(POLL_S)
        finally:
            for each in submitted:
                each.cancel()


def _probe(launch: Launch, folder: Path) -> None:
    with CONNECTORS[launch.engine](launch, 1, folder):
        pass


class _RetriedJob:
    """A job submitted to an engine, and again when its worker dies."""

    def __init__(self, submit: Submit, job: Job) -> None:
        self._submit, self._job, self._count = submit, job, 0
        self._handle: Handle | None = None
        self._submit_job()
        self.result: Any = None

    def done(self) -> bool:
        """Whether there is a result. Raises what the job has raised."""
        if self._handle is None or not self._handle.done():
            return self._handle is None
        try:
            result = self._handle.result()
        except Exception as error:  # each engine has many errors of its own
            result = WorkerDied(f"{type(error).__name__}: {error}")
        if isinstance(result, WorkerDied) and self._count < MAX_TRIES:
            self._submit_job()
            return False
        self._handle = None
        if isinstance(result, WorkerDied):
            raise StageError(f"a job has lost its worker {MAX_TRIES} times, at last: {result}") from result
        if isinstance(result, Exception):
            raise result
        self.result = result
        return True

    def _submit_job(self) -> None:
        self._count += 1
        try:
            self._handle = self._submit(self._job)
        except Exception as error:
            raise StageError(f"the engine takes no job: {type(error).__name__}: {error}") from error

    def cancel(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
