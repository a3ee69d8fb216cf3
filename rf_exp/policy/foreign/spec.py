"""Specification of a foreign policy, which replaces ours: `foreign` in conf/config.yaml, validated."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, get_args

from rf_exp.artifacts import drop_defaults
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.observations import Observations, State
from rf_exp.secrets import check_policy_server
from rf_exp.tasks import default_of
from rf_exp.types import CameraChoice

SOURCES = ("factory", "server")


@dataclass(frozen=True)
class Foreign:
    """One policy of all agents, by a factory or a server. Raises ArgumentError for invalid values."""

    name: str  # of its rows and files, in place of a recipe
    factory: str | None  # package.module:function
    options: Mapping[str, Any] | None = field(hash=False)  # keyword arguments of the factory
    server: str | None  # ws://host:port
    connect_s: float
    answer_s: float  # for one answer of the server
    action_steps: int | None  # executed steps of a chunk; None: all
    step_limit: int | None  # control steps of a scene; None: the task's
    demos: int  # number of our demonstrations that it was trained on, for its rows
    observations: Observations

    def __post_init__(self) -> None:
        if self.factory is None and self.options:
            raise ArgumentError("foreign.options are arguments of foreign.factory; there is none")
        if self.factory is not None:
            module, _, function = self.factory.partition(":")
            if not (function.isidentifier() and all(part.isidentifier() for part in module.split("."))):
                raise ArgumentError(
                    f"foreign.factory is {self.factory!r}; expected package.module:function, e.g. "
                    "my_package.my_module:make"
                )
        if self.server is not None:
            check_policy_server(self.server)
        for name in ("connect_s", "answer_s", "action_steps", "step_limit"):
            if (value := getattr(self, name)) is not None and value <= 0:
                raise ArgumentError(f"foreign.{name} is {value}; it must be positive")
        if self.demos < 0:
            raise ArgumentError(f"foreign.demos is {self.demos}; it must be at least 0")

    @property
    def identity(self) -> dict[str, Any]:
        """What determines its rollouts, but for the address of a server: the name stands for the policy."""
        names = ("name", "factory", "options", "action_steps")
        observations = drop_defaults(asdict(self.observations), calibration=False)
        return {**{name: getattr(self, name) for name in names}, "observations": observations}

    @property
    def observation(self) -> str:
        """The kind of its observations in rows: `state` for a privileged-state policy."""
        return "state" if self.observations.state == "full" else "pictures"


def foreign_policy(node: Mapping[str, Any], picture: Mapping[str, int]) -> dict[str, Any] | None:
    """The fields of a Foreign from `foreign` and `picture` of a configuration; None without a policy.

    Raises ArgumentError for a name without factory and server, for both of these, for one of them without a
    name, and for other fields without a policy.
    """
    sources = [source for source in SOURCES if node[source] is not None]
    if not sources and node["name"] is None:
        defaults = default_of("foreign")
        if changed := [key for key in node if node[key] != defaults[key]]:
            raise ArgumentError(
                f"foreign.{changed[0]} is given, and no policy is: "
                "foreign.name with foreign.factory or foreign.server"
            )
        return None
    if len(sources) != 1:
        problem = "both are given" if sources else "neither is given"
        raise ArgumentError(
            f"a foreign policy needs foreign.factory or foreign.server, one of them; {problem}"
        )
    if node["name"] is None:
        raise ArgumentError(
            f"foreign.{sources[0]} is given, and foreign.name is missing: its rows are named by it"
        )
    observations = node["observations"]
    for key, possible in (("state", get_args(State)), ("cameras", get_args(CameraChoice))):
        if observations[key] not in possible:
            raise unknown_choice(f"foreign.observations.{key}", observations[key], possible)
    return {**node, "observations": {**observations, **picture}}
