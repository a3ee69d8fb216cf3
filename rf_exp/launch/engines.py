"""Engines: `launch` in conf/config.yaml, checked, and for each engine a function that connects to it."""

import logging
import os
import signal
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from inspect import signature
from multiprocessing import current_process
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any, NamedTuple, Protocol

from rf_exp.errors import ArgumentError, StageError, picklable_error, unknown_choice
from rf_exp.processes import end_with_parent
from rf_exp.progress import console

LOCAL = "processes"  # of this machine, without an engine
IDLE_S = 300  # an idle process of loky ends after this time
RESERVED_PARAMETERS = {"self", "func", "args", "kwargs", "key", "pure"}  # parameters of Dask's Client.submit
TIMEOUT_MIN = 240  # of a job of submitit, unless options set it; submitit's default is 5

Job = Callable[[], Any]


class Handle(Protocol):
    """A job that was submitted to an engine."""

    def done(self) -> bool: ...

    def result(self) -> Any:
        """The result of a finished job, or its error as a value. Raises any error if its worker died."""

    def cancel(self) -> object: ...


Submit = Callable[[Job], Handle]


class Engine(NamedTuple):
    """Requirements of an engine; empty: none."""

    package: str = ""  # installed by the extra with the engine's name

    address: str = ""  # format of its address
    network: bool = False  # whether a server has to answer there


ENGINES = {
    LOCAL: Engine(),
    "loky": Engine("joblib"),
    "dask": Engine("distributed", "tcp://HOST:8786, or the file of the scheduler", True),
    "ray": Engine("ray", "HOST:6379, or auto for a cluster that has a node on this machine", True),
    "submitit": Engine("submitit", "slurm, or local to try it on this machine"),
}


@dataclass(frozen=True)
class Launch:
    """An engine and how it is reached. Raises ArgumentError for invalid values, before any work."""

    engine: str
    address: str | None
    shard_seeds: int  # consecutive seeds per job
    connect_s: float  # how long an engine may take to answer
    options: Mapping[str, Any] | None = field(hash=False)  # the engine's own options for each job

    def __post_init__(self) -> None:
        for key in ("shard_seeds", "connect_s"):
            if (value := getattr(self, key)) <= 0:
                raise ArgumentError(f"launch.{key} is {value}; it must be positive")
        if self.engine not in ENGINES:
            raise unknown_choice("launch.engine", self.engine, ENGINES)
        requirements = ENGINES[self.engine]
        for key in ("address", "options"):
            if getattr(self, key) and not requirements.address:
                raise ArgumentError(f"launch.{key} is given, and launch.engine={self.engine} has none")
        if requirements.address and not self.address:
            raise ArgumentError(f"launch.engine={self.engine} needs launch.address: {requirements.address}")
        if requirements.package and find_spec(requirements.package) is None:
            raise ArgumentError(
                f"launch.engine={self.engine} needs {requirements.package}, which is not installed; "
                f"run: pip install 'rf_exp[{self.engine}]'"
            )

    @property
    def label(self) -> str:
        """The engine and its address, for messages."""
        return f"{self.engine} {self.address}" if self.address else self.engine


def run_on_node(job: Job) -> Any:
    """Runs a job on a worker; returns its result, or its error, which not every engine transports."""
    for name in ("OMP_NUM_THREADS", "LP_NUM_THREADS"):  # one core per job, as jobs run side by side
        os.environ.setdefault(name, "1")
    try:
        return job()
    except Exception as error:
        return picklable_error(error)


@contextmanager
def connect_loky(launch: Launch, max_parallel: int, folder: Path) -> Iterator[Submit]:
    """loky: `max_parallel` processes of this machine; new ones for the next job when some died."""
    from joblib.externals.loky import get_reusable_executor

    executor = partial(
        get_reusable_executor, max_workers=max_parallel, timeout=IDLE_S, initializer=_init_worker
    )
    try:
        yield lambda job: executor().submit(run_on_node, job)
    finally:
        executor().shutdown(wait=True, kill_workers=True)


def _init_worker() -> None:
    """Initialises a process: its parent prints and handles Ctrl-C."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console.quiet = True


@contextmanager
def connect_dask(launch: Launch, max_parallel: int, folder: Path) -> Iterator[Submit]:
    """Dask: a scheduler and its workers on any machines; certificates come from Dask's own configuration."""
    from distributed import Client

    options, known = launch.options or {}, signature(Client.submit).parameters.keys() - RESERVED_PARAMETERS
    for name in options.keys() - known:
        raise unknown_choice("launch.options", name, known)
    address = str(launch.address)
    server: dict[str, Any] = {"address": address}
    if address.endswith(".json"):
        if not Path(address).is_file():
            raise StageError(f"launch.address={address}: no such file; Dask's scheduler writes it")
        server = {"scheduler_file": address}
    try:
        client = Client(**server, timeout=launch.connect_s, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # also for invalid addresses and certificates
        raise StageError(
            f"launch.address={address}: no scheduler of Dask answers within {launch.connect_s:g} s "
            f"({str(error) or type(error).__name__})"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=launch.connect_s)
        except TimeoutError as error:
            raise StageError(
                f"launch.address={address}: the scheduler has no worker after {launch.connect_s:g} s; "
                "start some with `dask worker`"
            ) from error
        yield lambda job: client.submit(_with_children, job, pure=False, **options)


def _with_children(job: Job) -> Any:
    # Dask's nanny makes its workers daemonic, and such processes may have no children. Our child, the process
    # that gives a seed its time limit, ends with the worker.
    current_process()._config["daemon"] = False  # pyright: ignore
    return run_on_node(job)


@contextmanager
def connect_ray(launch: Launch, max_parallel: int, folder: Path) -> Iterator[Submit]:
    """Ray: a cluster whose nodes declare their cores; each job takes one."""
    import ray
    from ray.exceptions import RayError

    class Remote:
        def __init__(self, reference: Any) -> None:
            self.reference = reference

        def done(self) -> bool:
            return bool(ray.wait([self.reference], timeout=0)[0])

        def result(self) -> Any:
            return ray.get(self.reference)

        def cancel(self) -> None:
            ray.cancel(self.reference, force=True)

    address = str(launch.address)
    if ":" in address:  # Ray itself would retry for minutes
        host, _, port = address.rpartition("://")[2].rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=launch.connect_s).close()
        except (OSError, ValueError) as error:
            raise StageError(
                f"launch.address={address}: no head of Ray answers within {launch.connect_s:g} s ({error})"
            ) from error
    handler = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (RayError, RuntimeError, ConnectionError, ValueError) as error:
        raise StageError(
            f"launch.address={address}: Ray cannot be joined: {error} (a cluster with a token wants "
            "RAY_AUTH_MODE=token here too, and RAY_AUTH_TOKEN_PATH or ~/.ray/auth_token)"
        ) from error
    finally:
        signal.signal(signal.SIGTERM, handler)  # Ray sets a handler of its own
    try:
        try:  # running.py retries after a worker's death, for all engines
            remote = ray.remote(**{"num_cpus": 1, "max_retries": 0, **(launch.options or {})})(run_on_node)
        except (ValueError, TypeError) as error:
            raise ArgumentError(f"launch.options, of ray.remote: {error}") from error
        yield lambda job: Remote(remote.remote(job))
    finally:
        ray.shutdown()


@contextmanager
def connect_submitit(launch: Launch, max_parallel: int, folder: Path) -> Iterator[Submit]:
    """submitit: a Slurm job for each of ours or, with the address `local`, a process of this machine.

    Jobs outlive this command if it is killed; if it ends otherwise, it cancels them. Raises ArgumentError
    where there is no Slurm, and for unknown options.
    """
    from submitit import AutoExecutor

    try:
        executor = AutoExecutor(folder / "submitit", cluster=launch.address)
        executor.update_parameters(**{"name": "rf_exp", "timeout_min": TIMEOUT_MIN, **(launch.options or {})})
    except (RuntimeError, ValueError, NameError, AssertionError, TypeError) as error:
        raise ArgumentError(f"launch.address={launch.address}, launch.options: {error}") from error

    def submit(job: Job) -> Handle:
        # On this machine submitit cancels processes by SIGINT. Where this process ignores it, as in the
        # background of a shell script, they would inherit that.
        ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN and current_thread() is main_thread()
        if ignored:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        try:
            return executor.submit(run_on_node, job)
        finally:
            if ignored:
                signal.signal(signal.SIGINT, signal.SIG_IGN)

    yield submit


CONNECTORS: Mapping[str, Callable[[Launch, int, Path], AbstractContextManager[Submit]]] = {
    "loky": connect_loky,
    "dask": connect_dask,
    "ray": connect_ray,
    "submitit": connect_submitit,
}
