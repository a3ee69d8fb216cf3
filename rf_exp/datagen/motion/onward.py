"""What an agent does next with a thing, estimated: a grasp is chosen so that it can be done, and soon."""

from collections.abc import Callable, Sequence
from functools import partial

from rf_exp.datagen.motion.destination import ends
from rf_exp.datagen.motion.reach import Onward, Reach, above
from rf_exp.datagen.motion.state import State, Unreachable
from rf_exp.datagen.motion.timing import estimated_s
from rf_exp.datagen.motion.ways import Points, effort_rad
from rf_exp.tasks import Task
from rf_exp.transforms import Matrix, inverse
from rf_exp.types import Subgoal

Line = Callable[[Points], Points | None]  # from joints (7,) to joint points (K, 7) of a motion

_WITH_HELD = ("lift", "carry", "place", "strike")  # verbs that move what is held


def onward(
    task: Task, reach: Reach, agent: int, name: str, following: Sequence[Subgoal], state: State
) -> Onward:
    """How long the following subgoals take that move an object, once it is held as from a TCP pose."""
    with_it = [each for each in following if each.object == name and each.verb in _WITH_HELD]

    def lifted(height_m: float, joints: Points) -> Points | None:
        return reach.line(agent, joints, above(reach.arms[agent].tcp(joints), height_m))

    def from_pose(goal: Matrix) -> Callable[[Points], float | None]:
        tcp_from_object = inverse(goal) @ state.poses[name]
        lines: list[Line] = []
        for each in with_it:
            if each.verb == "lift":
                assert each.height_m is not None  # parse_subgoal has seen to it
                lines.append(partial(lifted, each.height_m))
                continue
            try:
                tiers = ends(task, reach.arms[agent], each, state, tcp_from_object)
            except Unreachable:  # that will be said when its turn comes
                break
            lines.append(reach.arrive(agent, tiers))
        return partial(_takes_s, reach, lines)

    return from_pose


def _takes_s(reach: Reach, lines: Sequence[Line], joints: Points) -> float | None:
    """How long motions take from joints (7,) on, one after the other; None where there is no such motion."""
    total_s = 0.0
    for line in lines:
        points = line(joints)
        if points is None:
            return None
        total_s, joints = total_s + estimated_s(float(effort_rad(points)), reach.limits), points[-1]
    return total_s
