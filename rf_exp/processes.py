"""Process pool: results in order, a time limit for each job, and no child outlives its parent.

Every child has a pipe of its own: a queue shared by the children, as in the executors of the standard library
and joblib, stays locked for all when the child that holds its lock is stopped or killed. Idle children are
kept for the next jobs of their parent, because starting one costs ten seconds of imports.
"""

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, NamedTuple

from rf_exp.errors import WorkerDied, picklable_error

MAX_AHEAD = 4  # results per worker that may wait for an earlier one; bounds the memory
POLL_S = 0.5
# Environment variables that change during a run and do not affect a job: log service, current test.
VOLATILE_VARIABLES = frozenset({"WANDB_SERVICE", "PYTEST_CURRENT_TEST"})
SHELL_SIGNAL = 128  # a shell reports death by signal n as exit code 128 + n

# Spawned: a fork would inherit the renderer and the threads of this process.
_CONTEXT = multiprocessing.get_context("spawn")
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Timeout:
    """Takes the place of a result: the job exceeded its time limit, so its process was killed."""

    limit_s: float
    state: str  # of the process at that moment

    def __str__(self) -> str:
        return f"no result after {self.limit_s:g} s; its process, {self.state}, was killed"


def in_order(
    jobs: Iterable[Callable[[], Any]],
    workers: int,
    limit_s: float | None = None,
    grace_s: float = 0.0,
    meanwhile: Callable[[], None] | None = None,
) -> Iterator[Any]:
    """Yields the results of the jobs in their order, computed by `workers` processes, one job at a time each.

    A job that takes longer than `limit_s` is killed and yields a Timeout; the others continue. `meanwhile`
    is called a few times a second. Children end with this process, whatever ends it. If the caller stops
    early or an error occurs, busy children get a SIGTERM and are killed after at most `grace_s`. With one
    worker, no limit and no `meanwhile`, the jobs run in this process.

    Raises what a job raises, and WorkerDied when a child dies during its job.
    """
    if workers == 1 and limit_s is None and meanwhile is None:
        yield from (job() for job in jobs)
        return
    pool = _Pool(workers, limit_s)
    pending, next_job, next_result = iter(jobs), 0, 0
    try:
        while True:
            while next_job - next_result < MAX_AHEAD * workers and pool.has_capacity:
                if (job := next(pending, None)) is None:
                    break
                pool.give(next_job, job)
                next_job += 1
            if next_result in pool.finished:
                yield pool.finished.pop(next_result)
                next_result += 1
                continue
            if next_result == next_job:
                return
            if meanwhile is not None:
                meanwhile()
            pool.receive(often=meanwhile is not None)
    finally:
        pool.end(grace_s)


class _Pool:
    """At most `workers` children, and the results that they have finished."""

    def __init__(self, workers: int, limit_s: float | None) -> None:
        self._workers, self._limit_s = workers, limit_s
        self._answers: SimpleQueue[_Answer] = SimpleQueue()
        # What a child inherits at its start. It is reused only where that is the same, or results may differ.
        stable = sorted((name, value) for name, value in os.environ.items() if name not in VOLATILE_VARIABLES)
        self._inherited = workers > 1, os.getcwd(), tuple(sys.path), tuple(stable)
        reusable = [
            child for child in _idle if child.inherited == self._inherited and child.process.is_alive()
        ][:workers]
        for child in _idle:
            if child not in reusable:
                child.kill()
        _idle.clear()
        self._children = reusable
        for child in reusable:
            child.answers = self._answers
        self.finished: dict[int | None, Any] = {}  # number of a job -> its result

    @property
    def has_capacity(self) -> bool:
        """Whether a child is idle, or another one may be started."""
        return sum(child.busy for child in self._children) < self._workers

    def give(self, number: int, job: Callable[[], Any]) -> None:
        """Gives a job to an idle child, or to a new one."""
        idle = next((child for child in self._children if not child.busy), None)
        if idle is None:
            self._children.append(idle := _Child(self._answers, self._inherited))
        idle.give(number, job, self._limit_s)

    def receive(self, often: bool) -> None:
        """Waits for an answer; if none comes in time, kills the children past their deadline."""
        remaining_s = min(child.deadline for child in self._children) - time.monotonic()
        seconds = min(remaining_s, POLL_S if often else 3600.0)  # a queue takes no infinite timeout
        try:
            answer = self._answers.get(timeout=max(seconds, 0.0))
        except Empty:
            for child in [child for child in self._children if time.monotonic() > child.deadline]:
                self.finished[child.index] = Timeout(self._limit_s or 0.0, child.state())
                self._children.remove(child)
                child.kill()
            return
        if answer.child not in self._children:
            return  # from a child that was killed
        if answer.dead:
            self._children.remove(answer.child)
            if answer.child.busy:
                raise WorkerDied(answer.child.exit_message())
        elif answer.error is not None:
            raise answer.error
        else:
            self.finished[answer.child.index] = answer.value
            answer.child.index, answer.child.deadline = None, float("inf")

    def end(self, grace_s: float) -> None:
        """Ends busy children, which have `grace_s` to save their work; idle ones are kept for later jobs."""
        busy = [child.process for child in self._children if child.busy and grace_s > 0]
        for process in busy:
            process.terminate()
        deadline, unfinished = time.monotonic() + grace_s, {process.sentinel for process in busy}
        while unfinished and (remaining_s := deadline - time.monotonic()) > 0:
            unfinished.difference_update(wait(unfinished, remaining_s))  # pyright: ignore[reportArgumentType]
        for child in self._children:
            if child.busy or not child.process.is_alive():
                child.kill()
            else:
                _idle.append(child)


_idle: list["_Child"] = []  # children kept for the next jobs


def end_with_parent() -> None:
    """Has this process, a child of multiprocessing, killed when its parent ends, at once if it has ended."""
    parent = parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent.pid:  # the parent ended before prctl
        os._exit(1)


class _Answer(NamedTuple):
    child: "_Child"
    value: Any = None
    error: BaseException | None = None
    dead: bool = False


class _Child:
    """A worker process, seen from its parent; it runs one job at a time."""

    def __init__(self, answers: "SimpleQueue[_Answer]", inherited: tuple[bool, *tuple[object, ...]]) -> None:
        self.index: int | None = None  # of the current job
        self.deadline = float("inf")  # on the monotonic clock; infinity without a job or a limit
        self.answers, self.inherited = answers, inherited
        self._pipe, child_end = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(child_end,), daemon=True)
        with _spawn_environment(one_thread=inherited[0]):
            self.process.start()
        child_end.close()
        # Read in a thread: a child that is stopped in the middle of an answer must not block its parent.
        Thread(target=self._listen, daemon=True).start()

    @property
    def busy(self) -> bool:
        return self.index is not None

    def give(self, index: int, job: Callable[[], Any], limit_s: float | None) -> None:
        self.index = index
        self.deadline = float("inf") if limit_s is None else time.monotonic() + limit_s
        with suppress(OSError):  # it has died; the listener reports that
            self._pipe.send_bytes(pickle.dumps(job))

    def state(self) -> str:
        """The process state from /proc: running, sleeping, stopped, ...; `gone` if it cannot be read."""
        try:
            status = Path(f"/proc/{self.process.pid}/status").read_text()
        except OSError:
            return "gone"
        return status.split("State:")[1].split("(")[1].split(")")[0]

    def exit_message(self) -> str:
        """The message about a child that died during its job."""
        self.process.join(5.0)
        code = self.process.exitcode or 0
        number = -code if code < 0 else code - SHELL_SIGNAL
        cause = f"ended with exit code {code}"
        if number in set(signal.Signals):
            cause = f"was ended by {signal.Signals(number).name}"
        if number == signal.SIGKILL:
            cause += " (by hand, or because memory ran out: fewer workers and smaller pictures need less)"
        return (
            f"a worker, process {self.process.pid}, {cause}; run the same command again, it goes on from here"
        )

    def kill(self) -> None:
        self.process.kill()
        self.process.join(5.0)

    def _listen(self) -> None:
        while True:
            try:
                content = self._pipe.recv_bytes()
            except (EOFError, OSError):
                self._pipe.close()
                self.answers.put(_Answer(self, dead=True))
                return
            try:
                value, error = pickle.loads(content)
            except Exception as failure:  # unpickling may raise anything
                value, error = None, failure
            self.answers.put(_Answer(self, value, error))


@contextmanager
def _spawn_environment(one_thread: bool) -> Iterator[None]:
    """Context in which to start a child: with SIGINT blocked and, with `one_thread`, a single thread."""
    # By default every process starts a thread for each core.
    names = ("OMP_NUM_THREADS", "LP_NUM_THREADS") if one_thread else ()
    missing = [name for name in names if name not in os.environ]
    if multiprocessing.get_start_method(True) not in (None, *multiprocessing.get_all_start_methods()):
        # In a process of loky: children would get its start method, which they do not know.
        multiprocessing.set_start_method("spawn", force=True)
    resource_tracker.ensure_running()  # else it starts with the first child and unblocks SIGINT
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ.update(dict.fromkeys(missing, "1"))
    try:
        yield
    finally:
        for name in missing:
            del os.environ[name]
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def _serve(pipe: Connection) -> None:
    """Main loop of a child: runs jobs until the parent closes the pipe."""
    end_with_parent()
    while True:
        try:
            content = pipe.recv_bytes()
        except EOFError:
            return
        try:
            answer = pickle.dumps((pickle.loads(content)(), None))
        except KeyboardInterrupt:  # from a job that has saved its work after a SIGTERM
            os._exit(SHELL_SIGNAL + signal.SIGTERM)
        except Exception as error:
            answer = pickle.dumps((None, picklable_error(error)))
        pipe.send_bytes(answer)
