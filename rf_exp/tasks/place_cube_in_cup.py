"""Place Cube in Cup: one arm holds the cup out by its stem, the other drops the cube in."""

from math import hypot

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import above, at_rest, below, every, height_m, holders, near, upright
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.transforms import Matrix, inverse, planar
from rf_exp.types import Condition, Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

HOLDER, GIVER = 1, 2  # agents: the first holds the cup, the second drops the cube in
BETWEEN_M = (0.1, -0.05)  # x, y at which both arms reach the cup
LIFT_M = 0.03


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """`between`: world_from_object (4, 4) of the cup between the arms."""
    return {"between": planar(*BETWEEN_M, 0.0)}


def plan(scene: Scene, task: Task) -> Proposal:
    """Hold the cup out while the cube is fetched; drop the cube once the cup is in place."""
    if _inside(scene, task) and not holders(scene, "cube"):
        return Proposal((), ())
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    between = near(scene, "cup", task.places(scene)["between"], task.success["between_m"])
    if not (holders(scene, "cup") == (HOLDER,) and between):
        subgoals.append(Subgoal(HOLDER, "grasp", "cup", "stem"))
        constraints += grasping(subgoals)
        subgoals.append(Subgoal(HOLDER, "carry", "cup", target="between", height_m=LIFT_M))
        constraints += in_turn(Step(HOLDER, "carry", "cup"), Step(GIVER, "place", "cube"))
    drop = pick_and_place(GIVER, "cube", "cup", "inside")
    return Proposal((*subgoals, *drop), (*constraints, *grasping(drop), *keep_clear(task.agents)))


def _inside(scene: Scene, task: Task) -> Condition:
    """Whether the middle of the cube is within the walls of the cup, between its floor and its rim."""
    cup, size = task.asset("cup"), task.objects["cup"].size
    top_m = task.points["cube"]["top"][2, 3]
    cube = scene.poses["cube"].dot((0.0, 0.0, top_m / 2, 1.0))
    x_m, y_m, z_m, _ = inverse(scene.poses["cup"]).dot(cube).tolist()
    within = below(hypot(x_m, y_m), size * task.success["inside_m"], "m")
    return every((within, above(z_m, 0.0, "m"), below(z_m, float(cup.bounds_m[1, 2]), "m")))


def conditions(scene: Scene, start: Scene, task: Task) -> dict[str, Condition]:
    """The cube lies in the upright cup, which is held by its arm or stands released; all objects at rest."""
    limits, held = task.success, holders(scene, "cup")
    standing = below(height_m(scene, "cup"), limits["stands_m"], "m")
    return {
        "cube inside the cup": _inside(scene, task),
        "cup held or standing": held == (HOLDER,) or (not held and standing),
        "cup upright": upright(scene, "cup", limits["upright_deg"]),
        "cube released": not holders(scene, "cube"),
        "at rest": at_rest(scene, task.objects, limits),
    }


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: the cube is at the height of the cup and near it; the cup is not upset."""
    limits, size = task.success, task.objects["cup"].size
    over_m = height_m(scene, "cube") - height_m(scene, "cup")
    low = size * limits["paper_least_m"] < over_m < size * limits["paper_most_m"]
    upwards = upright(scene, "cup", limits["paper_tilt_deg"])
    return low and bool(upwards and near(scene, "cube", "cup", limits["paper_distance_m"]))
