"""Sentences that are understood, with their meanings."""

from rf_exp.constraints import compile_statement
from rf_exp.statements import (
    AvoidAgents,
    Before,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    LiesOn,
    Proposal,
    SameHeight,
    SpeedLimit,
    Statement,
    Step,
    read,
)
from rf_exp.types import Subgoal
from tests.constraints.robots import real

FOOD, BAR = real("place_food"), real("lift_barrier")
PROPOSAL = Proposal(
    (
        Subgoal(1, "grasp", "steak", "center"),
        Subgoal(1, "place", "steak", target="pot", target_point="inside"),
        Subgoal(2, "grasp", "lid", "knob"),
        Subgoal(2, "lift", "lid", height_m=0.1),
        Subgoal(2, "place", "lid", target="aside"),
    ),
    (),
)


def check_code(text: str, task=FOOD, proposal=PROPOSAL, agents=(1, 2)) -> str:
    """The check of a sentence, as printed in the paper."""
    return repr(compile_statement(read(text, task.vocabulary, agents), task, proposal))


LOGICAL = [
    ("Agent_1 must grasp steak at its center point.", "VI(Agent_1, steak, center)"),
    ("agent 1 should pick up the steak by its centre", "VI(Agent_1, steak, center)"),
    ("Agent_2 must grasp the knob point of lid.", "VI(Agent_2, lid, knob)"),
    ("Agent_1 must place steak at the inside point of pot.", "VI(Agent_1, pot, inside)"),
    ("Agent_1 must put the steak into the inside of the pot", "VI(Agent_1, pot, inside)"),
    ("The gripper of Agent_1 must be perpendicular to steak.", "VD(Agent_1, steak, perpendicular)"),
    ("The gripper of Agent_1 is perpendicular to steak when grasping.", "VD(Agent_1, steak, perpendicular)"),
    ("The gripper of Agent_2 should be level at the lid", "VD(Agent_2, lid, level)"),
    ("The gripper of Agent_2 must be horizontal to lid", "VD(Agent_2, lid, horizontal)"),
    ("Agent_1 must approach steak from above.", "VD(Agent_1, steak, vertical)"),
    ("Agent_1 must approach steak perpendicularly.", "VD(Agent_1, steak, perpendicular)"),
    (
        "Agent_1 and Agent_2 must keep a consistent gripper height.",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
    (
        "Agent_1 and Agent_2 must maintain a consistent gripper height",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
    (
        "Keep the gripper height consistent between Agent_1 and Agent_2.",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
]
TEMPORAL = [
    ("Agent_1 and Agent_2 perform tasks simultaneously.",
     "VS([Agent_1, Agent_2], simultaneous, within 0.1 s)"),
    ("Agent_1 and Agent_2 must perform their tasks at the same time within 2 seconds",
     "VS([Agent_1, Agent_2], simultaneous, within 2 s)"),
    ("Agent_2 must lift lid before Agent_1 may place steak.",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_2 must raise the lid before Agent_1 begins to put the steak",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_1 must place steak only after Agent_2 lifts lid.",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_1 places the steak after Agent_2 has opened the lid",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_2 must complete its task before Agent_1 begins.", "VS([Agent_2, Agent_1], sequential)"),
    ("Agent_2 must complete the task before Agent_1 can begin their action.",
     "VS([Agent_2, Agent_1], sequential)"),
    ("Agent_2 must lift lid before Agent_1 starts.", "VS([Agent_2, Agent_1], sequential, lift lid)"),
    ("Agent_1 must wait 2 s after Agent_2 has finished.", "VS([Agent_2, Agent_1], sequential, wait 2 s)"),
    ("Agent_1 waits at least 0.5 seconds after Agent_2", "VS([Agent_2, Agent_1], sequential, wait 0.5 s)"),
    ("Agent_1 must wait 2 s after Agent_2 lifts lid.",
     "VS([Agent_2, Agent_1], sequential, lift lid, wait 2 s)"),
    ("Agent_1 must finish within 10 s.", "VS(Agent_1, deadline, 10 s)"),
    ("Agent_2 must lift lid within 10 s.", "VS(Agent_2, deadline, lift lid, 10 s)"),
    ("Agent_1 and Agent_2 may share the same space one after the other.",
     "VS([Agent_1, Agent_2], share space)"),
    ("Agent_2 and Agent_1 could share the same space chronologically.",
     "VS([Agent_2, Agent_1], share space)"),
]  # fmt: skip
SPATIAL = [
    ("Avoid collision between Agent_1 and other agents.", "VSO(Agent_1)"),
    ("AVOID COLLISIONS BETWEEN AGENT_2 AND OTHER AGENTS", "VSO(Agent_2)"),
    ("Agent_2 must not intersect with the trajectories of other agents.", "VSO(Agent_2)"),
    ("Avoid collision between Agent_1 and Agent_2.", "VSO([Agent_1, Agent_2])"),
    ("Agent_1 should not occupy the same space as Agent_2.", "VSO([Agent_1, Agent_2])"),
    ("Agents must avoid colliding with each other.", "VSO([Agent_1, Agent_2])"),
    ("Agent_1 must avoid Agent_2.", "VSO([Agent_1, Agent_2])"),
    (
        "Agent_1 may not enter the region (0, 0, 0) to (1, 1, 1)",
        "VSO(Agent_1, zone (0.0, 0.0, 0.0) to (1.0, 1.0, 1.0))",
    ),
    ("Agent_1 and Agent_2 must not collide.", "VSO([Agent_1, Agent_2])"),
    ("Avoid collision between Agent_1 and the objects.", "VSO(Agent_1, objects)"),
    ("Agent_1 must not touch any other objects", "VSO(Agent_1, objects)"),
    ("Avoid collision between Agent_2 and the environment.", "VSO(Agent_2, objects)"),
    (
        "Agent_1 must stay out of zone (-0.1, 0.2, 0) to (0.1, 0.4, 0.5).",
        "VSO(Agent_1, zone (-0.1, 0.2, 0.0) to (0.1, 0.4, 0.5))",
    ),
]
LIFT, PLACE, BOX = Step(2, "lift", "lid"), Step(1, "place", "steak"), ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
ZONE = "zone (0, 0, 0) to (1, 1, 1)"
ENGLISH: dict[str, Statement] = {
    # agents
    "Agent 1 and 2 must keep the same gripper height": SameHeight((1, 2)),
    "Agents 1 and 2 keep a consistent height": SameHeight((1, 2)),
    "Robots 1 and 2 must maintain identical gripper heights": SameHeight((1, 2)),
    "Robot 1 must not collide with robot 2": AvoidAgents((1, 2)),
    "The left arm must not touch the right arm.": AvoidAgents((1, 2)),
    "The right robot must finish within 3 s": Deadline(Step(2), 3.0),
    "Agents must avoid colliding with each other": AvoidAgents((1, 2)),
    # orders
    "Agent_1 must not place the steak before Agent 2 has lifted the lid": Before(LIFT, PLACE),
    "Agent 1 mustn't place the steak until Agent 2 has lifted the lid": Before(LIFT, PLACE),
    "Agent_1 must wait until Agent_2 has lifted the lid": Before(LIFT, Step(1)),
    "Agent_1 waits for Agent_2 to lift the lid": Before(LIFT, Step(1)),
    "Agent_1 waits for Agent_2 to finish": Before(Step(2), Step(1)),
    "Agent_1 waits until Agent_2 has lifted the lid before placing the steak": Before(LIFT, PLACE),
    "Agent_1 waits until Agent 2 has let go of the lid": Before(Step(2, "release", "lid"), Step(1)),
    "First Agent 2 lifts the lid, then Agent 1 places the steak.": Before(LIFT, PLACE),
    "Agent 2 lifts the lid and then Agent 1 puts the steak": Before(LIFT, PLACE),
    "After Agent 2 has lifted the lid, Agent 1 must place the steak": Before(LIFT, PLACE),
    "Before Agent 1 places the steak, Agent 2 must lift the lid": Before(LIFT, PLACE),
    "Agent 1 must place the steak once the lid has been lifted by Agent 2": Before(LIFT, PLACE),
    "The lid must be lifted by Agent 2 before Agent 1 starts placing the steak": Before(LIFT, PLACE),
    "Agent_2 must lift the lid before Agent_1 begins to lift the steak": Before(
        LIFT, Step(1, "lift", "steak")
    ),
    "Agent_1 must wait until the lid is on the table": Before(LiesOn("lid"), Step(1)),
    "Agent_1 must place the steak only after the lid lies on the table": Before(LiesOn("lid"), PLACE),
    "Agent_2 must wait until the steak is on the pot": Before(LiesOn("steak", "pot"), Step(2)),
    "Agent_1 must place the steak at least 2 s after Agent_2 lifts the lid": Before(LIFT, PLACE, 2.0),
    # limits
    "Agents 1 and 2 must keep their grippers at least 10 cm apart": KeepApart((1, 2), 0.1),
    "The grippers of Agent_1 and Agent_2 must stay at least 70 mm apart": KeepApart((1, 2), 0.07),
    "Agent_1 must stay at least 5 cm away from Agent_2": KeepApart((1, 2), 0.05, "arms"),
    "Keep the pot upright": KeepLevel("pot"),
    "Agent_2 must keep the lid level within 5 degrees": KeepLevel("lid", 5.0, 2),
    "The lid must be kept upright": KeepLevel("lid"),
    "Agent_1 must keep its gripper below 40 cm over the table": KeepHeight(1, 0.4),
    "The hand of Agent_2 must stay above 2 cm": KeepHeight(2, 0.02, "above"),
    "Agent_1 must not move faster than 20 cm/s": SpeedLimit(1, 0.2),
    "Agent_2 must move its gripper no faster than 0.3 m/s": SpeedLimit(2, 0.3),
    # conditions in time
    f"Agent_1 must stay out of {ZONE} while Agent_2 is there": KeepOut(1, *BOX, occupied_by=2),
    f"Agent_1 must not enter the {ZONE} as long as the lid is still in it": KeepOut(
        1, *BOX, occupied_by="lid"
    ),
    f"Agent_1 must stay out of {ZONE} until the lid is on the table": KeepOut(1, *BOX, until=LiesOn("lid")),
    f"Agent_1 must avoid {ZONE} until Agent_2 is done": KeepOut(1, *BOX, until=Step(2)),
    "Agents 1 and 2 must keep the same height when lifting the lid": SameHeight((1, 2), "lift", "lid"),
    "Agent_2 must keep its gripper level while lifting the lid": Direction(2, "lid", "level", "lift"),
    "The gripper of Agent_2 must stay vertical when carrying the lid": Direction(
        2, "lid", "vertical", "carry"
    ),
}
