"""Spatial checks in signal temporal logic."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.checks.avoidance import AvoidAgents, AvoidObjects, apart_m
from rf_exp.constraints.checks.keep_out import StayOut
from rf_exp.constraints.checks.touching import CONTACT_N
from rf_exp.constraints.stl.execution import Execution, Signal
from rf_exp.constraints.stl.form import (
    VOID,
    Specification,
    always,
    bounded,
    named,
    of_schedule,
    step_parts,
    stl_of,
)
from rf_exp.geometry import OBJECT_MARGIN_M, TABLE_MARGIN_M, lowest_m, nearest
from rf_exp.statements import agent_name
from rf_exp.tasks import Task


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
    things = always([f"{each.name} >= {OBJECT_MARGIN_M!r}" for each in clear], "m")
    # A formula of its own: hands work nearer to the table than things are, which would hide those.
    table = always([f"{each.name} >= {TABLE_MARGIN_M!r}" for each in low], "m")
    return of_schedule((things, table), *clear, *low)


def _clearance(agent: int) -> Signal:
    def clearance_m(execution: Execution) -> NDArray[np.float64]:
        paths, at = execution.plan.paths, execution.positions(agent)
        body, still = paths.swept[agent - 1], paths.still[agent - 1]
        low_m, found = lowest_m(body), {}
        for position in np.unique(at).tolist():
            gap = nearest(body, still, np.array([[position, 0]]))
            found[position] = 2 * VOID if gap is None else gap.distance_m  # less the margin still void
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
        zone = named(zone, "until", *step_parts(check.until))
    how = f"from {agent_name(check.agent)}, measured, with what it holds, to the zone; negative: inside"
    return bounded(check, (f"outside_{zone}", how), ">", 0.0, (f"closed_{zone}", "the zone is closed"))
