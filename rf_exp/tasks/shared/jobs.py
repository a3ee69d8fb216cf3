"""Jobs: pick-and-place of one object each, in a partial order, for a given agent or the best suited one.

For tasks composed from a sentence (`rf_exp.compose`). Lengths in m, angles in degrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from rf_exp.statements import Before, Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import above, below, every, holders, set_down
from rf_exp.tasks.shared.placing import pick_and_place
from rf_exp.transforms import inverse
from rf_exp.types import ANY_AGENT, Condition, Measured, Scene, Subgoal


@dataclass(frozen=True)
class Job:
    """Pick-and-place job: an object is grasped at a point and put at a point of a target."""

    thing: str
    grip: str  # a grasp point of the object
    target: str
    point: str  # a place or drop point of the target
    after: tuple[str, ...] = ()  # objects that have to be in place before
    agent: int = ANY_AGENT


def plan(scene: Scene, task: Task, jobs: Sequence[Job]) -> Proposal:
    """Each object that is not in place is fetched; an agent that already holds one keeps it."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    agents: dict[str, int] = {}
    for job in jobs:
        held = holders(scene, job.thing)
        if not held and in_place(scene, task, job):
            continue
        agent = agents[job.thing] = held[0] if held else job.agent
        steps = pick_and_place(agent, job.thing, job.target, job.point, job.grip)
        prerequisites = [Step(agents[first], "place", first) for first in job.after if first in agents]
        subgoals += steps
        constraints += grasping(steps)
        constraints += [Before(first, Step(agent, "place", job.thing)) for first in prerequisites]
    return Proposal(tuple(subgoals), (*constraints, *keep_clear(task.agents)) if subgoals else ())


def conditions(scene: Scene, task: Task, jobs: Sequence[Job]) -> dict[str, Condition]:
    """Each object is in place, upright, released and at rest."""
    places = {f"{job.thing} at {job.point} of {job.target}": in_place(scene, task, job) for job in jobs}
    return {**places, **set_down(scene, [job.thing for job in jobs], task.success)}


def in_place(scene: Scene, task: Task, job: Job) -> Measured:
    """Whether the object of a job is in place: on the place point, or within the walls of the container.

    Reads the thresholds `beside_m` and `above_m`.
    """
    target, point = task.asset(job.target), task.points[job.target][job.point]
    target_from_object = inverse(scene.poses[job.target]) @ scene.poses[job.thing]
    if target.points[job.point].kind == "drop":
        low, high = target.bounds_m
        within_m = float(min(high[:2] - low[:2])) / 2  # of the walls; handles stick out along one axis
        x_m, y_m, height_m = target_from_object[:3, 3].tolist()
        inside = below(hypot(x_m, y_m), within_m, "m")
        return every((inside, above(height_m, 0.0, "m"), below(height_m, float(high[2]), "m")))
    x_m, y_m, off_m = (target_from_object[:3, 3] - point[:3, 3]).tolist()
    centred = below(hypot(x_m, y_m), task.success["beside_m"], "m")
    return every((centred, below(abs(off_m), task.success["above_m"], "m")))
