"""Logical checks in signal temporal logic."""

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.checks.direction import ANGLE_MEASURED_DEG, ValidateDirection
from rf_exp.constraints.checks.height import HEIGHT_MEASURED_M, ConsistentHeight
from rf_exp.constraints.checks.interaction import PLACES, POSITION_M, POSITION_MEASURED_M, ValidateInteraction
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import Specification, always, bounded, condition, named, stl_of
from rf_exp.statements import agent_name
from rf_exp.tasks import Task


@stl_of.register
def _(check: ValidateInteraction, task: Task) -> Specification:
    about = check.agent, check.object, check.point
    point = task.asset(check.object).points[check.point]
    if point.kind not in PLACES:
        how = (
            f"from the measured gripper of {agent_name(check.agent)} to point {check.point} of {check.object}"
        )
        when = f"{agent_name(check.agent)} has made contact with {check.object} in this control step"
        return bounded(
            check, (named("offset", *about), how), "<=", POSITION_MEASURED_M, (named("meets", *about), when)
        )

    def ends(execution: Execution) -> NDArray[np.bool_]:
        evidence = check.planned(execution.plan)
        moment_s = execution.plan.begins_s + execution.clock_s
        return np.isclose(moment_s, evidence.time_s) & (evidence.time_s > 0)

    offset = Signal(
        named("beside", *about),
        "m",
        f"on the level, from what {agent_name(check.agent)} puts down, as commanded, to point {check.point}",
        lambda execution: np.full(len(execution), check.planned(execution.plan).value),
    )
    when = "the commanded motion that puts it down ends in this control step"
    puts = Signal(named("puts", *about), "", when, lambda execution: condition(ends(execution)))
    bound_m = point.slack_m + POSITION_M
    return Specification(
        (always([f"{offset.name} <= {bound_m!r}"], "m", puts),), (offset, puts), measured=False
    )


@stl_of.register
def _(check: ValidateDirection, task: Task) -> Specification:
    phase = (check.phase.verb or "all",) if check.phase else ()
    about = check.agent, check.object, check.orientation, *phase
    how = f"angle of the measured gripper of {agent_name(check.agent)} off {check.orientation}"
    when = (
        f"{check.phase.text} goes on"
        if check.phase
        else f"{agent_name(check.agent)} has made contact with {check.object} in this control step"
    )
    return bounded(
        check, (named("angle", *about), how), "<=", ANGLE_MEASURED_DEG, (named("judged_angle", *about), when)
    )


@stl_of.register
def _(check: ConsistentHeight, task: Task) -> Specification:
    about = *check.agents, *((check.phase[0].verb or "all",) if check.phase else ())
    how = "between the highest and the lowest rise of the measured grippers since each began to carry"
    when = "all of them hold one thing, and are where they have to keep level"
    return bounded(
        check, (named("spread", *about), how), "<=", HEIGHT_MEASURED_M, (named("together", *about), when)
    )
