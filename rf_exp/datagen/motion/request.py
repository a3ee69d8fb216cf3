"""What a motion primitive is asked for, and what it makes of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rf_exp.datagen.motion.branches import Points
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.state import State
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix
from rf_exp.types import Segment, Subgoal


@dataclass(frozen=True)
class Request:
    """A subgoal, and what comes next: things are grasped and placed so that it can be done, and soon."""

    task: Task
    reach: Reach
    subgoal: Subgoal
    following: Sequence[Subgoal] = ()  # of the same agent
    of_others: Sequence[Subgoal] = ()  # what the other agents have still to do

    @property
    def agent(self) -> int:
        return self.subgoal.agent

    def taker(self, name: str) -> Subgoal | None:
        """The grasp of the agent that takes a thing next from where this one puts it down."""
        return next((each for each in self.of_others if (each.verb, each.object) == ("grasp", name)), None)

    def tcp(self, state: State) -> Matrix:
        """world_from_tcp of the agent."""
        return self.reach.arms[self.agent].tcp(state.qpos[self.agent])

    def segment(
        self,
        primitive: str,
        points: Points,
        state: State,
        touches: frozenset[str] = frozenset(),
        joined: str | None = None,
    ) -> tuple[Segment, State]:
        """A segment along timed points (T, dof), with what is held, and the state at its end."""
        agent = self.agent
        name, tcp_from_object = state.held.get(agent, (None, None))
        gripper = np.full(len(points), state.gripper[agent])
        if len(points):
            state = state.moved(agent, points[-1], self.reach.arms[agent].tcp(points[-1]))
        touches = touches | {name} if name is not None else touches
        made = Segment(
            agent, self.subgoal, primitive, points, gripper, name, tcp_from_object, touches, joined
        )
        return made, state
