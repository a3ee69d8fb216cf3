"""Four Robots Stack Cube: two arms pass one cube each to two others, which stack them on the goal."""

from math import dist

from rf_exp.statements import Proposal, Statement, Step, grasping, keep_clear
from rf_exp.tasks import Task
from rf_exp.tasks.predicates import holders, near, on, released
from rf_exp.tasks.shared import stacking
from rf_exp.tasks.shared.placing import in_turn, pick_and_place
from rf_exp.transforms import Matrix, planar
from rf_exp.types import Scene, Subgoal

VERSION = "1"
PLAN_VERSION = "1"

LANES = {"blue": (1, 3), "red": (2, 4)}  # cube -> (giver, taker), agents
STOP_M = (0.35, 0.5)  # x, y of the transfer of blue; x is mirrored for red


def places(scene: Scene, task: Task) -> dict[str, Matrix]:
    """Transfer places: agent 1 puts the blue cube down for agent 3 at `stop1`."""
    x_m, y_m = STOP_M
    return {"stop1": planar(x_m, y_m, 0.0), "stop2": planar(-x_m, y_m, 0.0)}


def plan(scene: Scene, task: Task) -> Proposal:
    """Both cubes are passed on; the red one is placed once the blue one lies on the goal."""
    subgoals: list[Subgoal] = []
    constraints: list[Statement] = []
    placed = stacking.cubes_in_place(scene, task, [*LANES])
    for (cube, agents), in_place in zip(LANES.items(), placed, strict=True):
        if in_place and released(scene, [cube]) and not subgoals:
            continue
        giver, taker = agents
        if _with_giver(scene, task, cube):
            subgoals += pick_and_place(giver, cube, f"stop{giver}")
            constraints += in_turn(Step(giver, "place", cube), Step(taker, "grasp", cube))
        subgoals += pick_and_place(taker, cube, *(("goal", "middle") if cube == "blue" else ("blue", "top")))
    takers = {agent for _, agent in LANES.values()}
    if takers <= {subgoal.agent for subgoal in subgoals}:
        constraints += in_turn(*(Step(taker, "place", cube) for cube, (_, taker) in LANES.items()))
    return Proposal(tuple(subgoals), (*grasping(subgoals), *constraints, *keep_clear(task.agents)))


def _with_giver(scene: Scene, task: Task, cube: str) -> bool:
    """Whether the giver holds the cube, or no agent does and it is nearer to the giver than to the taker."""
    held, (giver, taker) = holders(scene, cube), LANES[cube]
    if held:
        return giver in held
    position = scene.poses[cube][:2, 3].tolist()
    bases = [(task.robots[agent - 1].x_m, task.robots[agent - 1].y_m) for agent in (giver, taker)]
    return dist(position, bases[0]) < dist(position, bases[1])


conditions = stacking.conditions_of_two


def paper(scene: Scene, start: Scene, task: Task) -> bool:
    """The release's criterion: red above blue, blue near the goal, neither held by an arm of its lane."""
    limits = task.success
    if any(agent in holders(scene, cube) for cube, agents in LANES.items() for agent in agents):
        return False
    above = on(scene, task, "red", "blue", limits["paper_beside_m"])
    return bool(above) and bool(near(scene, "blue", "goal", limits["paper_goal_m"]))
