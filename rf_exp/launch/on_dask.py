"""Dask: a scheduler and its workers, wherever they are."""

from collections.abc import Iterator
from contextlib import contextmanager
from inspect import signature
from multiprocessing import current_process
from pathlib import Path
from typing import Any

from distributed import Client

from rf_exp.errors import StageError, choices
from rf_exp.launch.running import Job, Submit, on_node
from rf_exp.launch.spec import Launch

NOT_OPTIONS = {"self", "func", "args", "kwargs", "key", "pure"}  # of the parameters of Client.submit


@contextmanager
def connected(launch: Launch, at_once: int, folder: Path) -> Iterator[Submit]:
    """Within, jobs go to a scheduler. Raises StageError where it does not answer in time, or has no worker.

    Certificates of a tls:// address are those of Dask's own configuration.
    """
    options, possible = launch.options or {}, signature(Client.submit).parameters.keys() - NOT_OPTIONS
    for name in options.keys() - possible:
        raise choices("launch.options", name, possible)
    address = str(launch.address)
    where: dict[str, Any] = {"address": address}
    if address.endswith(".json"):
        if not Path(address).is_file():
            raise StageError(f"launch.address={address}: no such file; Dask's scheduler writes it")
        where = {"scheduler_file": address}
    try:
        client = Client(**where, timeout=launch.connect_s, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # also of addresses and certificates
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
    # Dask's nanny makes its workers daemonic, which may have no children. Ours, the process in which a seed
    # has its time limit, ends with the worker.
    current_process()._config["daemon"] = False  # pyright: ignore
    return on_node(job)
