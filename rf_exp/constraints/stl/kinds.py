"""The form of every kind of check in signal temporal logic."""

from collections.abc import Callable
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.limits import (
    MEASURED_DEG,
    MEASURED_M,
    MEASURED_SPEED,
    Distance,
    Height,
    Speed,
    Tilt,
)
from rf_exp.constraints.logical import (
    ANGLE_MEASURED_DEG,
    HEIGHT_MEASURED_M,
    PLACES,
    POSITION_M,
    POSITION_MEASURED_M,
    ConsistentHeight,
    ValidateDirection,
    ValidateInteraction,
)
from rf_exp.constraints.spatial import CONTACT_N, AvoidAgents, AvoidObjects, StayOut, apart_m
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import (
    CLOCK_S,
    VOID,
    Formula,
    Specification,
    always,
    bounded,
    condition,
    named,
    stl_of,
)
from rf_exp.constraints.temporal import Deadline, Sequential, ShareSpace, Simultaneous, times_s
from rf_exp.geometry import OBJECT_MARGIN_M, TABLE_MARGIN_M, lowest_m, nearest
from rf_exp.statements import Step, agent_name
from rf_exp.tasks import Task

# -- limits ------------------------------------------------------------------------------------------


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


# -- logical -----------------------------------------------------------------------------------------


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


# -- temporal ----------------------------------------------------------------------------------------


@stl_of.register
def _(check: Sequential, task: Task) -> Specification:
    ended, begun = _since(check.first, "end"), _begun(check.then)
    return _of_schedule((always([f"{ended.name} >= {check.wait_s - CLOCK_S!r}"], "s", begun),), ended, begun)


@stl_of.register
def _(check: Simultaneous, task: Task) -> Specification:
    begins = [(_since(step, "begin"), _begun(step)) for step in check.steps]
    formulas = tuple(
        always([f"abs({a.name} - {b.name}) <= {check.within_s + CLOCK_S!r}"], "s", a_begun, b_begun)
        for (a, a_begun), (b, b_begun) in combinations(begins, 2)
    )
    return _of_schedule(formulas, *(signal for pair in begins for signal in pair))


@stl_of.register
def _(check: Deadline, task: Task) -> Specification:
    clock = Signal("clock", "s", "since the plan began", lambda execution: execution.clock_s)

    def unfinished(execution: Execution) -> NDArray[np.float64]:
        times = times_s(check.step, execution.plan)
        return condition(execution.clock_s <= (-np.inf if times is None else times[1] + CLOCK_S))

    how = f"{check.step.text} is not over before this control step, by the commands given"
    open_ = Signal(named("unfinished", *_step(check.step)), "", how, unfinished)
    return _of_schedule((always([f"clock <= {check.within_s + CLOCK_S!r}"], "s", open_),), clock, open_)


@stl_of.register
def _(check: ShareSpace, task: Task) -> Specification:
    return Specification(silent="it is a permission, which no execution can violate")


def _of_schedule(formulas: tuple[Formula, ...], *signals: Signal) -> Specification:
    return Specification(formulas, signals, measured=False)


def _step(step: Step) -> tuple[object, ...]:
    return step.agent, *(part for part in (step.verb, step.object) if part)


def _since(step: Step, edge: Literal["begin", "end"]) -> Signal:
    """Since when a part has made its first step or its last one."""

    def since(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        if times is None:  # what does not move is in nobody's way
            return np.full(len(execution), VOID)
        return execution.clock_s - times[edge == "end"]

    last = "last" if edge == "end" else "first"
    how = f"since the command of the {last} step of {step.text}; negative before it"
    return Signal(named("since", edge, *_step(step)), "s", how, since)


def _begun(step: Step) -> Signal:
    def begun(execution: Execution) -> NDArray[np.float64]:
        times = times_s(step, execution.plan)
        return condition(execution.clock_s >= (np.inf if times is None else times[0] - CLOCK_S))

    return Signal(named("begun", *_step(step)), "", f"{step.text} has begun, by the commands given", begun)


# -- spatial -----------------------------------------------------------------------------------------


@stl_of.register
def _(check: AvoidAgents, task: Task) -> Specification:
    pairs = check.pairs(task)
    if not pairs:
        return Specification(silent="there is no other agent to avoid")
    gaps, forces = [_gap(pair) for pair in pairs], [_force(pair) for pair in pairs]
    return Specification(
        (
            always([f"{gap.name} > 0" for gap in gaps], "m", strict=True),
            always([f"{force.name} <= {CONTACT_N!r}" for force in forces], "N"),
        ),
        (*gaps, *forces),
    )


def _gap(pair: tuple[int, int]) -> Signal:
    who = " and ".join(map(agent_name, pair))
    how = f"exact distance of the measured arms of {who} with what they hold; negative: penetration"
    return Signal(named("distance", *pair), "m", how, lambda execution: _each(apart_m, execution, pair))


def _force(pair: tuple[int, int]) -> Signal:
    how = f"largest force between the arms of {' and '.join(map(agent_name, pair))}; 0 without contact"

    def forces(execution: Execution) -> NDArray[np.float64]:
        return np.array(
            [
                max((n for a, b, n in scene.arm_contacts if tuple(sorted((a, b))) == pair), default=0.0)
                for scene in execution.scenes
            ]
        )

    return Signal(named("force", *pair), "N", how, forces)


def _each(measure: Callable[..., float], execution: Execution, *given: object) -> NDArray[np.float64]:
    return np.array([measure(execution.plan, scene, *given) for scene in execution.scenes])


@stl_of.register
def _(check: AvoidObjects, task: Task) -> Specification:
    clear = [_clearance(agent) for agent in check.agents]
    low = [_lowest(agent) for agent in check.agents]
    margins = [f"{each.name} >= {OBJECT_MARGIN_M!r}" for each in clear]
    margins += [f"{each.name} >= {TABLE_MARGIN_M!r}" for each in low]
    return _of_schedule((always(margins, "m"),), *clear, *low)


def _clearance(agent: int) -> Signal:
    def clearance_m(execution: Execution) -> NDArray[np.float64]:
        paths, at = execution.plan.paths, execution.positions(agent)
        body, still = paths.swept[agent - 1], paths.still[agent - 1]
        low_m, found = lowest_m(body), {}
        for position in np.unique(at).tolist():
            gap = nearest(body, still, np.array([[position, 0]]))
            found[position] = VOID if gap is None else gap.distance_m
            if paths.blocked[agent - 1][position] and low_m[position] >= TABLE_MARGIN_M:  # doubt counts
                found[position] = min(found[position], np.nextafter(OBJECT_MARGIN_M, 0.0))
        return np.array([found[position] for position in at.tolist()])

    how = (
        f"from {agent_name(agent)} where it is commanded to what nobody moves and it may not touch; "
        "less than the margin where the motion to the next step may be"
    )
    return Signal(named("clearance", agent), "m", how, clearance_m)


def _lowest(agent: int) -> Signal:
    how = f"lowest point of {agent_name(agent)} where it is commanded, with what it carries, over the table"
    return Signal(
        named("lowest", agent),
        "m",
        how,
        lambda execution: lowest_m(execution.plan.paths.swept[agent - 1])[execution.positions(agent)],
    )


@stl_of.register
def _(check: StayOut, task: Task) -> Specification:
    zone = named(check.agent, *map(float, (*check.low_m, *check.high_m)))
    if check.occupied_by is not None:
        zone = named(zone, "while", check.occupied_by)
    elif check.until is not None:
        zone = named(zone, "until", *_step(check.until))
    how = f"from {agent_name(check.agent)}, measured, with what it holds, to the zone; negative: inside"
    return bounded(check, (f"outside_{zone}", how), ">", 0.0, (f"closed_{zone}", "the zone is closed"))
