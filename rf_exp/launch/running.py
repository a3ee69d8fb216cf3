"""Jobs on an engine: results in the order of the jobs, and another try for one whose worker died."""

import time
from collections import deque
from collections.abc import Generator, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from rf_exp.errors import StageError, WorkerDied
from rf_exp.launch.engines import CONNECTED, ENGINES, Handle, Job, Launch, Submit
from rf_exp.processes import Timeout, in_order

TRIES = 3  # of a job whose worker dies
AHEAD = 4  # jobs for each one at a time that may be begun before an earlier one is done
LOOK_EVERY_S = 0.1


def results(launch: Launch, jobs: Iterable[Job], at_once: int, folder: Path) -> Generator[Any, None, None]:
    """Results of the jobs, in their order; the engine is asked for `at_once` of them at a time.

    Jobs are pickled, so they are made of what a module has by name. `folder`, which all machines see, is for
    what the engine writes. A caller that stops early cancels the rest.

    Raises what a job raises, and StageError where nobody answers or a job's worker has died three times.
    """
    if ENGINES[launch.engine].network:
        # Asked in a process that can be ended: clients wait for ever for one who listens and is no engine.
        (answer,) = in_order([partial(_ask, launch, folder)], 1, 2 * launch.connect_s)
        if isinstance(answer, Timeout):
            raise StageError(
                f"launch.address={launch.address}: nobody speaks {launch.engine} there: {answer}"
            )
    with CONNECTED[launch.engine](launch, at_once, folder) as submit:
        waiting = iter(jobs)
        begun: deque[_Try] = deque()
        try:
            while True:
                while len(begun) < AHEAD * at_once and sum(not each.done() for each in begun) < at_once:
                    if (job := next(waiting, None)) is None:
                        break
                    begun.append(_Try(submit, job))
                if not begun:
                    return
                if begun[0].done():
                    yield begun.popleft().result
                else:
                    time.sleep(LOOK_EVERY_S)
        finally:
            for each in begun:
                each.cancel()


def _ask(launch: Launch, folder: Path) -> None:
    with CONNECTED[launch.engine](launch, 1, folder):
        pass


class _Try:
    """A job that was given to an engine, and is given again when its worker dies."""

    def __init__(self, submit: Submit, job: Job) -> None:
        self._submit, self._job, self._tries = submit, job, 0
        self._handle: Handle | None = None
        self._give()
        self.result: Any = None

    def done(self) -> bool:
        """Whether there is a result. Raises what the job has raised."""
        if self._handle is None or not self._handle.done():
            return self._handle is None
        try:
            result = self._handle.result()
        except Exception as error:  # an engine's own, of which each has many
            result = WorkerDied(f"{type(error).__name__}: {error}")
        if isinstance(result, WorkerDied) and self._tries < TRIES:
            self._give()
            return False
        self._handle = None
        if isinstance(result, WorkerDied):
            raise StageError(f"a job has lost its worker {TRIES} times, at last: {result}") from result
        if isinstance(result, Exception):
            raise result
        self.result = result
        return True

    def _give(self) -> None:
        self._tries += 1
        try:
            self._handle = self._submit(self._job)
        except Exception as error:
            raise StageError(f"the engine takes no job: {type(error).__name__}: {error}") from error

    def cancel(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
