"""Where jobs run: `launch` in conf/config.yaml, checked."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, NamedTuple

from rf_exp.errors import ArgumentError, choices

HERE = "processes"  # of this machine, without any engine


class Engine(NamedTuple):
    """What an engine needs; empty: nothing."""

    package: str = ""
    extra: str = ""  # of pyproject.toml, that brings the package
    address: str = ""  # what its address is
    network: bool = False  # whether somebody has to answer there


ENGINES = {
    HERE: Engine(),
    "loky": Engine("joblib"),
    "dask": Engine("distributed", "dask", "tcp://HOST:8786, or the file of the scheduler", True),
    "ray": Engine("ray", "ray", "HOST:6379, or auto for a cluster that has a node on this machine", True),
    "submitit": Engine("submitit", "submitit", "slurm, or local to try it on this machine"),
}


@dataclass(frozen=True)
class Launch:
    """An engine and how it is reached. Raises ArgumentError for what cannot be, before any work."""

    engine: str
    address: str | None
    shard_seeds: int  # consecutive seeds that are one job
    connect_s: float  # how long an engine may take to answer
    options: Mapping[str, Any] | None = field(hash=False)  # the engine's own, of each job

    def __post_init__(self) -> None:
        for key in ("shard_seeds", "connect_s"):
            if (value := getattr(self, key)) <= 0:
                raise ArgumentError(f"launch.{key} is {value}; it must be positive")
        if self.engine not in ENGINES:
            raise choices("launch.engine", self.engine, ENGINES)
        needs = ENGINES[self.engine]
        for key in ("address", "options"):
            if getattr(self, key) and not needs.address:
                raise ArgumentError(f"launch.{key} is given, and launch.engine={self.engine} has none")
        if needs.address and not self.address:
            raise ArgumentError(f"launch.engine={self.engine} needs launch.address: {needs.address}")
        if needs.package and find_spec(needs.package) is None:
            raise ArgumentError(
                f"launch.engine={self.engine} needs {needs.package}, which is not installed; "
                f"run: pip install 'rf_exp[{needs.extra}]'"
            )

    @property
    def said(self) -> str:
        """The engine and where it is, for people."""
        return f"{self.engine} {self.address}" if self.address else self.engine
