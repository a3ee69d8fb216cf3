"""Ray: the nodes of a cluster, each of which says how many cores it has."""

import logging
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError

from rf_exp.errors import ArgumentError, StageError
from rf_exp.launch.running import Submit, on_node
from rf_exp.launch.spec import Launch


@contextmanager
def connected(launch: Launch, at_once: int, folder: Path) -> Iterator[Submit]:
    """Within, jobs go to a cluster, one core each. Raises StageError where none answers in time."""
    address = str(launch.address)
    if ":" in address:  # Ray itself tries for minutes
        _knock(address, launch.connect_s)
    told = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (RayError, RuntimeError, ConnectionError, ValueError) as error:
        raise StageError(
            f"launch.address={address}: Ray cannot be joined: {error} (a cluster with a token wants "
            "RAY_AUTH_MODE=token here too, and RAY_AUTH_TOKEN_PATH or ~/.ray/auth_token)"
        ) from error
    finally:
        signal.signal(signal.SIGTERM, told)  # Ray sets a handler of its own
    try:
        try:  # another try after a worker's death is given in running.py, for all engines
            remote = ray.remote(**{"num_cpus": 1, "max_retries": 0, **(launch.options or {})})(on_node)
        except (ValueError, TypeError) as error:
            raise ArgumentError(f"launch.options, of ray.remote: {error}") from error
        yield lambda job: _Handle(remote.remote(job))
    finally:
        ray.shutdown()


def _knock(address: str, seconds: float) -> None:
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=seconds).close()
    except (OSError, ValueError) as error:
        raise StageError(
            f"launch.address={address}: no head of Ray answers within {seconds:g} s ({error})"
        ) from error


@dataclass(frozen=True)
class _Handle:
    reference: Any

    def done(self) -> bool:
        return bool(ray.wait([self.reference], timeout=0)[0])

    def result(self) -> Any:
        return ray.get(self.reference)

    def cancel(self) -> None:
        ray.cancel(self.reference, force=True)
