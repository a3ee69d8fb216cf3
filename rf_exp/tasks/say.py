"""The sentences in which constraints are stated, in the forms of the paper's prompts.

One function a form, so that plans and the checker's grammar cannot drift apart.
"""

from collections.abc import Iterable

from rf_exp.types import Constraint, Subgoal


def grasping(subgoals: Iterable[Subgoal]) -> list[Constraint]:
    """Interaction position and direction of everything that subgoals grasp."""
    grasps = [each for each in subgoals if each.verb == "grasp" and each.object and each.point]
    positions = [grasp_at(each.agent, each.object or "", each.point or "") for each in grasps]
    return positions + [perpendicular(each.agent, each.object or "") for each in grasps]


def keep_clear(agents: Iterable[int]) -> list[Constraint]:
    """Nobody touches another agent, nor an object that his subgoals are not about."""
    agents = tuple(agents)
    return [avoid_agents(agent) for agent in agents] + [avoid_objects(agent) for agent in agents]


def _agent(agent: int) -> str:
    return f"Agent_{agent}"


def grasp_at(agent: int, name: str, point: str) -> Constraint:
    """Interaction position: the agent grasps the object at an annotated point."""
    return Constraint("logical", (agent,), f"{_agent(agent)} must grasp {name} at its {point} point.")


def press_at(agent: int, name: str, point: str) -> Constraint:
    """Interaction position: the agent presses the object at an annotated point."""
    return Constraint("logical", (agent,), f"{_agent(agent)} must press {name} at its {point} point.")


def perpendicular(agent: int, name: str) -> Constraint:
    """Interaction direction: the gripper comes along the annotated direction."""
    return Constraint("logical", (agent,), f"The gripper of {_agent(agent)} must be perpendicular to {name}.")


def same_height(a: int, b: int) -> Constraint:
    """Two agents keep what they carry level."""
    return Constraint(
        "logical", (a, b), f"{_agent(a)} and {_agent(b)} must keep a consistent gripper height."
    )


def together(a: int, b: int, verb: str, name: str, within_s: float) -> Constraint:
    """Two agents do the same thing at the same time."""
    return Constraint(
        "temporal",
        (a, b),
        f"{_agent(a)} and {_agent(b)} must {verb} {name} simultaneously within {within_s:g} s.",
    )


def before(first: int, verb: str, name: str, second: int, verb2: str, name2: str) -> Constraint:
    """One agent finishes a subgoal before another begins one."""
    return Constraint(
        "temporal",
        (first, second),
        f"{_agent(first)} must {verb} {name} before {_agent(second)} may {verb2} {name2}.",
    )


def in_turn(first: int, second: int) -> Constraint:
    """One agent finishes all that it does before another begins."""
    return Constraint(
        "temporal", (first, second), f"{_agent(first)} must complete its task before {_agent(second)} begins."
    )


def share_space(a: int, b: int) -> Constraint:
    """Two agents may use the same space at different times."""
    return Constraint(
        "temporal", (a, b), f"{_agent(a)} and {_agent(b)} may share the same space one after the other."
    )


def avoid_agents(agent: int) -> Constraint:
    """An agent touches no other agent."""
    return Constraint("spatial", (agent,), f"Avoid collision between {_agent(agent)} and other agents.")


def avoid_objects(agent: int) -> Constraint:
    """An agent touches nothing but what its subgoal is about."""
    return Constraint("spatial", (agent,), f"Avoid collision between {_agent(agent)} and the objects.")
