"""The paper's four architectures (section 4.2), and two of ours, as views of one data set.

A stream is the unit of observation and command: the pictures of one camera, and one or more agents. A
policy learns from all streams of its view together and acts through each of them at rollout.

| architecture    | policies       | streams of each                                |
|-----------------|----------------|------------------------------------------------|
| shared_global   | joint          | (global, all agents)                           |
| shared_local    | shared         | (agent1, agent 1), ... (agentN, agent N)       |
| separate_global | agent1 ..      | (global, agent k)                              |
| separate_local  | agent1 ..      | (agentk, agent k)                              |

`separate_both` is separate_local with the pictures of the global camera beside those of the own one.
`separate_coordinated` is separate_local with subgoals from a coordinator
(`rf_exp.policy.inputs.coordination`).
"""

from dataclasses import asdict, dataclass
from typing import Any

from rf_exp.artifacts import drop_defaults
from rf_exp.errors import ArgumentError
from rf_exp.types import ARM_JOINTS, Arch

ACTION_SIZE = ARM_JOINTS + 1  # joint targets (rad) and gripper command, for each agent
PROPRIO_SIZE = ARM_JOINTS + 1  # measured joint positions (rad) and gripper opening (m), for each agent
MOST_AGENTS = 16


@dataclass(frozen=True)
class Stream:
    """The pictures of a camera, or of several side by side, with the joints of some agents (from 1 on)."""

    camera: str
    agents: tuple[int, ...]
    more: tuple[str, ...] = ()  # cameras beside the first

    @property
    def cameras(self) -> tuple[str, ...]:
        """From left to right."""
        return (self.camera, *self.more)


@dataclass(frozen=True)
class View:
    """Streams that one policy learns from and commands, each with as many agents and as many cameras.

    Raises ArgumentError for streams that differ in these, or that command an agent twice.
    """

    name: str
    streams: tuple[Stream, ...]
    coordinated: bool = False

    def __post_init__(self) -> None:
        agents = self.agents
        sizes = {(len(each.agents), len(each.cameras)) for each in self.streams}
        possible = set(range(1, MOST_AGENTS + 1))
        if len(sizes) != 1 or not agents or len(set(agents)) < len(agents) or not possible.issuperset(agents):
            few = self.streams[:MOST_AGENTS]
            raise ArgumentError(
                f"streams of view {self.name!r} command agents {[list(each.agents) for each in few]} through "
                f"cameras {[list(each.cameras) for each in few]}; expected as many of each in all of them, "
                f"and each agent, from 1 to {MOST_AGENTS}, once"
            )
        if max(len(each.cameras) for each in self.streams) > MOST_AGENTS + 1:
            raise ArgumentError(f"a stream of view {self.name!r} has more than {MOST_AGENTS + 1} cameras")

    @property
    def identity(self) -> dict[str, Any]:
        """Its fields, but for neutral values."""
        streams = [drop_defaults(asdict(stream), more=()) for stream in self.streams]
        return drop_defaults({**asdict(self), "streams": streams}, coordinated=False)

    @property
    def agents(self) -> tuple[int, ...]:
        """The agents this policy commands."""
        return tuple(agent for stream in self.streams for agent in stream.agents)

    @property
    def action_size(self) -> int:
        return ACTION_SIZE * len(self.streams[0].agents)

    @property
    def proprio_size(self) -> int:
        return PROPRIO_SIZE * len(self.streams[0].agents)


def views(arch: Arch, agents: int) -> tuple[View, ...]:
    """Views of an architecture, which command each agent once. Raises ArgumentError for less than one."""
    if agents < 1:
        raise ArgumentError(f"agents is {agents}; expected at least 1")
    all_agents = tuple(range(1, agents + 1))
    if arch.shared_policy and arch.global_view:
        own_cameras = tuple(f"agent{k}" for k in all_agents)
        return (
            View("joint", (Stream("global", all_agents, own_cameras * arch.both_views),), arch.coordinated),
        )
    streams = []
    for agent in all_agents:
        first, other = ("global", f"agent{agent}") if arch.global_view else (f"agent{agent}", "global")
        streams.append(Stream(first, (agent,), (other,) * arch.both_views))
    if arch.shared_policy:
        return (View("shared", tuple(streams), arch.coordinated),)
    return tuple(View(f"agent{stream.agents[0]}", (stream,), arch.coordinated) for stream in streams)
