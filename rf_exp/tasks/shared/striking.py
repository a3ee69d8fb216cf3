"""Striking a cube with a held hammer: shared by Strike Cube and Strike Cube Hard."""

from math import degrees, dist

from rf_exp.tasks import Task
from rf_exp.tasks.predicates import below, holders, once
from rf_exp.transforms import angle_between_rad
from rf_exp.types import Condition, Scene, Subgoal

LIFT_M = 0.06  # off the table, before the hammer moves over the cube
DOWN = (0.0, 0.0, -1.0)


def take_and_strike(scene: Scene, agent: int) -> list[Subgoal]:
    """Grasp the handle, lift, bring the head down on the cube; the last alone once the agent holds it."""
    take = Subgoal(agent, "grasp", "hammer", "handle"), Subgoal(agent, "lift", "hammer", height_m=LIFT_M)
    strike = Subgoal(agent, "strike", "hammer", "head", target="cube", target_point="top")
    return [strike] if holders(scene, "hammer") == (agent,) else [*take, strike]


@once
def face(scene: Scene, task: Task) -> tuple[float, list[float]]:
    """Distance (m) between the centres of striking face and cube top, and the striking direction (3,)."""
    # `dot` takes less than half the time of `@`, which matters in every control step.
    head = scene.poses["hammer"].dot(task.points["hammer"]["head"])
    top = scene.poses["cube"].dot(task.points["cube"]["top"])
    return dist(head[:3, 3].tolist(), top[:3, 3].tolist()), head[:3, 2].tolist()


def struck(scene: Scene, task: Task, agent: int) -> bool:
    """Whether the agent holds the hammer with its face on the cube, which ends the plan."""
    return holders(scene, "hammer") == (agent,) and face(scene, task)[0] < task.success["struck_m"]


def conditions(scene: Scene, task: Task, agent: int) -> dict[str, Condition]:
    """The held hammer rests on the cube with its face down.

    Reads the thresholds `struck_m` and `face_deg`.
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
