"""A hammer that is held with its face on top of a cube."""

from math import degrees, dist

from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, holders, once
from rf_exp.transforms import angle_between_rad
from rf_exp.types import Condition, Scene, Subgoal

LIFT_M = 0.06  # off the table, before the hammer swings over the cube
DOWN = (0.0, 0.0, -1.0)


def take_and_strike(scene: Scene, agent: int) -> list[Subgoal]:
    """Grasp the handle, lift, bring the head down on the cube; of one that holds it the last alone."""
    take = Subgoal(agent, "grasp", "hammer", "handle"), Subgoal(agent, "lift", "hammer", height_m=LIFT_M)
    strike = Subgoal(agent, "strike", "hammer", "head", target="cube", target_point="top")
    return [strike] if holders(scene, "hammer") == (agent,) else [*take, strike]


@once
def face(scene: Scene, task: Task) -> tuple[float, list[float]]:
    """Of the striking face: from its middle to that of the cube's top, in m, and which way it strikes."""
    # `dot` is `@` in less than half of the time, which counts in every control step.
    head = scene.poses["hammer"].dot(task.points["hammer"]["head"])
    top = scene.poses["cube"].dot(task.points["cube"]["top"])
    return dist(head[:3, 3].tolist(), top[:3, 3].tolist()), head[:3, 2].tolist()


def struck(scene: Scene, task: Task, agent: int) -> bool:
    """Whether the agent holds the hammer with its face on the cube: nothing is left to do."""
    return holders(scene, "hammer") == (agent,) and face(scene, task)[0] < task.success["struck_m"]


def conditions(scene: Scene, task: Task, agent: int) -> dict[str, Condition]:
    """The held hammer stands on the cube with its face down.

    Reads `struck_m` and `face_deg` of the task's thresholds.
    """
    limits, (gap_m, way) = task.success, face(scene, task)
    return {
        "hammer held": holders(scene, "hammer") == (agent,),
        "face on the cube": below(gap_m, limits["struck_m"], "m"),
        "face down": below(degrees(angle_between_rad(way, DOWN)), limits["face_deg"], "deg"),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the hammer's head is near the top of the cube."""
    return face(scene, task)[0] < task.success["paper_gap_m"]
