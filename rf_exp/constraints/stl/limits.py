"""Limits in signal temporal logic."""

from rf_exp.constraints.checks.distance import Distance
from rf_exp.constraints.checks.limits import MEASURED_DEG, MEASURED_M, MEASURED_SPEED, Height, Speed, Tilt
from rf_exp.constraints.stl.form import Specification, bounded, named, stl_of
from rf_exp.statements import agent_name
from rf_exp.tasks import Task


@stl_of.register
def _(check: Distance, task: Task) -> Specification:
    how = f"between the measured {check.parts} of {' and '.join(map(agent_name, check.agents))}"
    bound_m = max(0.0, check.at_least_m - MEASURED_M)
    return bounded(check, (named("distance", check.parts, *check.agents), how), ">=", bound_m)


@stl_of.register
def _(check: Tilt, task: Task) -> Specification:
    name = named("tilt", check.object, *check.agents)
    how = f"angle of what pointed up on {check.object} when the plan began, against up"
    held = f"one of the agents {check.agents} holds {check.object}"
    bound_deg = check.within_deg + MEASURED_DEG
    return bounded(check, (name, how), "<=", bound_deg, (f"holds_{name}", held))


@stl_of.register
def _(check: Height, task: Task) -> Specification:
    signal = (
        named("height", check.agent),
        f"of the measured gripper of {agent_name(check.agent)} over the table",
    )
    if check.side == "below":
        return bounded(check, signal, "<=", check.limit_m + MEASURED_M)
    return bounded(check, signal, ">=", check.limit_m - MEASURED_M)


@stl_of.register
def _(check: Speed, task: Task) -> Specification:
    how = f"of the gripper of {agent_name(check.agent)}, by measured joint positions and velocities"
    return bounded(
        check, (named("speed", check.agent), how), "<=", check.at_most_m_s * MEASURED_SPEED * (1 + 1e-9)
    )
