"""Signal temporal logic: every kind of check has formulas, and the verdicts of rtamt and monitor agree."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.constraints import Check, Paths, Plan, RoboChecker, checked_kinds, compile_statement
from rf_exp.constraints.checks.avoidance import AvoidObjectsCheck
from rf_exp.constraints.checks.direction import ANGLE_MEASURED_DEG
from rf_exp.constraints.checks.interaction import POSITION_MEASURED_M
from rf_exp.constraints.checks.keep_level import MEASURED_DEG
from rf_exp.constraints.checks.speed_limit import MEASUREMENT_FACTOR
from rf_exp.constraints.plan import MEASUREMENT_TOLERANCE_M
from rf_exp.constraints.stl import (
    MAX_MARGIN,
    Execution,
    evaluate_check,
    evaluate_formula,
    monitor_verdict,
    signals,
)
from rf_exp.coordination import sequential
from rf_exp.datagen import EpisodeGenerator, Planned, Settings, Trace
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.geometry import lowest_m
from rf_exp.sim import shared_simulator
from rf_exp.statements import (
    AvoidAgents,
    AvoidObjects,
    Before,
    ContactAt,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    PlaceAt,
    Proposal,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
)
from rf_exp.transforms import transform
from rf_exp.types import CONTROL_DT_S, NO_PICTURES, ConstraintSet, Scene
from tests.constraints.robots import REACHING, REST, idle, real, scene_of, walk

Executed = tuple[Planned, Execution]
TASKS = ("lift_barrier", "place_food")


@pytest.fixture(scope="module")
def episodes() -> dict[str, list[Executed]]:
    """Task -> the executed plans of its first episode."""
    found = {}
    for name in TASKS:
        task, trace = real(name), Trace()
        settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
        world = shared_simulator(task, NO_PICTURES)
        assert EpisodeGenerator(settings, world, settings.make_brain(0), trace).make(0).success
        found[name] = trace.executions()
    return found


def agreed(execution: Execution, check: Check) -> bool:
    """The common verdict of formulas and monitor; asserts that they agree."""
    found = all(each.holds for each in evaluate_check(execution, check))
    assert found == monitor_verdict(execution, check), (check, evaluate_check(execution, check))
    return found


def check_for(planned: Planned, execution: Execution, stated: Statement) -> Check:
    return compile_statement(stated, execution.plan.task, planned.proposal)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_formulas_and_monitor_agree_on_every_check_of_an_episode(episodes, name):
    for planned, execution in episodes[name]:
        assert len(execution) > 20 and all(agreed(execution, check) for check in planned.checked.checks)
        times = [scene.step for scene in execution.scenes]
        assert times == list(range(times[0], times[0] + len(execution)))
        assert times[0] == execution.plan.scene.step + 1
        forms = [check.stl(execution.plan.task) for check in planned.checked.checks]
        descriptions = {(signal.name, signal.description) for form in forms for signal in form.signals}
        # Signals of one name are equal.
        assert len(descriptions) == len(signals(execution, planned.checked.checks))


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_the_robustness_of_clearance_is_its_planned_distance_minus_the_bound(episodes, name):
    """For objects and table separately, so that neither hides the other."""
    seen = 0
    for planned, execution in episodes[name]:
        for check, evidence in zip(planned.checked.checks, planned.checked.evidence, strict=True):
            if not isinstance(check, AvoidObjectsCheck):
                continue
            objects, table = evaluate_check(execution, check)
            low_m = [
                lowest_m(execution.plan.paths.swept[agent - 1])[execution.positions(agent)].min()
                for agent in check.agents
            ]
            assert table.robustness == pytest.approx(min(low_m), abs=1e-9)
            if objects.applies:
                # Including the start and steps that were not executed.
                margin_m = evidence.value - evidence.bound
                assert objects.robustness >= margin_m - 1e-9
                if evidence.time_s <= execution.plan.begins_s + execution.clock_s[-1]:
                    assert objects.robustness == pytest.approx(margin_m, abs=2e-3)
                seen += table.robustness < objects.robustness - 0.01
    assert seen or name == "lift_barrier"  # it has no resting object on the table


# task, statement, field of its check, measured worst value -> value of the field at the boundary
LIMITS: list[tuple[str, Statement, str, Any]] = [
    ("lift_barrier", KeepApart((1, 2), 0.1), "at_least_m", lambda value: value + MEASUREMENT_TOLERANCE_M),
    (
        "lift_barrier",
        KeepApart((1, 2), 0.1, "arms"),
        "at_least_m",
        lambda value: value + MEASUREMENT_TOLERANCE_M,
    ),
    ("lift_barrier", KeepLevel("barrier"), "within_deg", lambda value: value - MEASURED_DEG),
    ("lift_barrier", KeepHeight(1, 0.3), "limit_m", lambda value: value - MEASUREMENT_TOLERANCE_M),
    ("lift_barrier", KeepHeight(1, 0.3, "above"), "limit_m", lambda value: value + MEASUREMENT_TOLERANCE_M),
    ("lift_barrier", SpeedLimit(2, 0.3), "at_most_m_s", lambda value: value / MEASUREMENT_FACTOR),
    ("lift_barrier", Together((1, 2)), "within_s", lambda value: value),
    ("lift_barrier", Deadline(Step(1, "grasp", "barrier"), 5.0), "within_s", lambda value: value),
    ("place_food", Before(Step(2, "lift", "lid"), Step(1, "place", "steak")), "wait_s", lambda value: value),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stated", "field", "bound"),
    LIMITS,
    ids=[f"{type(stated).__name__}-{k}" for k, (_, stated, *_) in enumerate(LIMITS)],
)
def test_limits_are_judged_equally_at_below_and_above_the_measured_value(
    episodes, name, stated, field, bound
):
    planned, execution = episodes[name][0]
    check: Any = check_for(planned, execution, stated)  # a frozen dataclass
    values = [each.value for each in execution.measured(check) if each is not None]
    values = values or [check.planned(execution.plan).value]
    is_minimum = field in ("at_least_m", "wait_s") or getattr(check, "side", "") == "above"
    boundary = bound(min(values) if is_minimum else max(values))
    inside, outside = (-1e-6, 1e-6) if is_minimum else (1e-6, -1e-6)
    agreed(execution, replace(check, **{field: boundary}))
    assert agreed(execution, replace(check, **{field: boundary + inside}))
    assert not agreed(execution, replace(check, **{field: boundary + outside}))
    results = evaluate_check(execution, replace(check, **{field: boundary + inside}))
    assert results[0].robustness == pytest.approx(1e-6, rel=0.5)


def changed(execution: Execution, **values: Any) -> Execution:
    """The execution with fields of every scene replaced by values or by functions of the scene."""
    scenes = []
    for scene in execution.scenes:
        found = {name: each(scene) if callable(each) else each for name, each in values.items()}
        scenes.append(replace(scene, **found))
    return Execution(execution.plan, scenes)


@pytest.mark.slow
@pytest.mark.parametrize("far_m", [0.0, POSITION_MEASURED_M - 1e-6, POSITION_MEASURED_M, 0.031])
def test_the_contact_point_of_a_gripper(episodes, far_m):
    planned, execution = episodes["lift_barrier"][0]
    check = check_for(planned, execution, ContactAt(1, "grasp", "barrier", "left"))
    point = execution.plan.task.asset("barrier").points["left"].object_from_tcp

    def poses(scene: Scene) -> dict[str, np.ndarray]:
        tcp = execution.plan.planning_scene.arms[0].tcp(scene.qpos[0])
        aside = transform((far_m, 0, 0)) @ tcp @ np.linalg.inv(point)
        return {**scene.poses, "barrier": aside}

    verdict = agreed(changed(execution, poses=poses), check)
    if far_m != POSITION_MEASURED_M:  # at the bound, rounding decides, equally for both
        assert verdict == (far_m < POSITION_MEASURED_M)


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [0.0, ANGLE_MEASURED_DEG - 3, ANGLE_MEASURED_DEG + 3])
def test_the_contact_direction_of_a_gripper(episodes, turn_deg):
    planned, execution = episodes["lift_barrier"][0]
    turn = transform((0, 0, 0), Rotation.from_euler("z", turn_deg, degrees=True))
    check = check_for(planned, execution, Direction(1, "barrier"))
    rotated = changed(execution, poses=lambda scene: {"barrier": scene.poses["barrier"] @ turn})
    assert agreed(rotated, check) == (turn_deg < ANGLE_MEASURED_DEG)
    during_grasp = check_for(planned, execution, Direction(1, "barrier", "vertical", "grasp"))
    agreed(execution, during_grasp)


def test_two_arms_that_lift_one_object(episodes):
    planned, execution = episodes["lift_barrier"][-1]
    check = check_for(planned, execution, SameHeight((1, 2)))
    assert agreed(execution, check) and evaluate_check(execution, check)[0].applies
    bent = changed(execution, qpos=lambda scene: scene.qpos + np.eye(2, 1) @ np.eye(1, 9, 3) * 0.1)
    assert not agreed(bent, check)


def test_a_placed_object(episodes):
    planned, execution = episodes["place_food"][0]
    check = check_for(planned, execution, PlaceAt(1, "steak", "pot", "inside"))
    assert agreed(execution, check) and evaluate_check(execution, check)[0].applies
    paths = execution.plan.paths
    poses = {**paths.scene.poses, "pot": transform((0.2, 0, 0)) @ paths.scene.poses["pot"]}
    elsewhere = Paths(paths.task, paths.constraint_set, replace(paths.scene, poses=poses), paths.trajectories)
    assert not agreed(Execution(Plan(elsewhere, execution.plan.schedule), execution.scenes), check)


ACROSS = np.array([0.0, 1.1, 0.0, -0.8, 0.0, 1.9, 0.785])  # stretched out over the middle of the table
DOWN = REACHING + np.array([0, 0.5, 0, 0, 0, 0, 0])  # on the table


def execution_to(goal: NDArray[np.float64], *agents: int) -> Execution:
    """Execution in which the given agents of two move to joint positions, one after the other."""
    task = real("lift_barrier")
    moving = tuple(walk(each, [REST, goal], 20) if each in agents else idle(each) for each in (1, 2))
    checker = RoboChecker(task, Proposal((), ()), ConstraintSet("full"))
    paths = checker.paths(moving, scene_of(task))
    plan = Plan(paths, sequential(moving, Proposal((), ())))
    steps = range(1, len(plan.schedule) + 1)
    scenes = []
    for step in steps:
        qpos = paths.scene.qpos.copy()
        for agent in (1, 2):
            qpos[agent - 1, :7] = moving[agent - 1].path()[plan.positions(agent)[step], :7]
        scenes.append(replace(paths.scene, step=step, qpos=qpos))
    return Execution(plan, scenes)


@pytest.mark.parametrize(
    ("agents", "force_n", "holds"),
    [((1,), 0.0, True), ((1,), 1.0, True), ((1,), 1.001, False), ((1, 2), 0.0, False)],
)
def test_arms_that_touch(agents, force_n, holds):
    execution = changed(execution_to(REACHING, *agents), arm_contacts=((2, 1, force_n),))
    check = compile_statement(AvoidAgents((1, 2)), execution.plan.task, Proposal((), ()))
    assert agreed(execution, check) == holds


@pytest.mark.parametrize(("agents", "holds"), [((), True), ((1,), False)])
def test_an_arm_too_near_to_objects(agents, holds):
    execution = execution_to(DOWN, *agents)
    assert (
        agreed(execution, compile_statement(AvoidObjects(1), execution.plan.task, Proposal((), ()))) == holds
    )


@pytest.mark.parametrize(
    ("low_m", "more", "holds"),
    [
        ((0.5, 0.5, 0.5), {}, True),
        ((-0.2, -0.2, 0.0), {}, False),
        ((-0.2, -0.2, 0.0), {"occupied_by": 2}, False),
        ((-0.2, -0.2, 0.0), {"occupied_by": "barrier"}, False),
        ((-0.2, -0.2, 0.0), {"until": Step(2)}, True),
    ],
)
def test_a_zone(low_m, more, holds):
    execution = execution_to(ACROSS, 1)
    zone = KeepOut(1, low_m, tuple(side + 0.4 for side in low_m), **more)
    assert agreed(execution, compile_statement(zone, execution.plan.task, Proposal((), ()))) == holds


def test_a_permission_has_no_formula(episodes):
    planned, execution = episodes["place_food"][0]
    form = check_for(planned, execution, ShareSpace((1, 2))).stl(execution.plan.task)
    assert not form.formulas and "permission" in form.no_formulas_reason


def test_every_kind_of_statement_has_a_form_and_a_case_here(episodes):
    """A new kind of the package needs both."""
    cases = {type(stated) for _, stated, *_ in LIMITS}
    cases |= {ContactAt, Direction, SameHeight, PlaceAt, AvoidAgents, AvoidObjects, KeepOut, ShareSpace}
    own_checks = {kind: check for kind, check in checked_kinds().items() if "rf_exp." in kind.__module__}
    assert cases == own_checks.keys()
    assert all(check.stl is not Check.stl for check in own_checks.values())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("always(x <= 0.03)", 0.0),
        ("always((g >= 0) implies (x <= 0.02))", pytest.approx(0.01)),
        ("always(x >= 0.015)", pytest.approx(-0.005)),
        ("always(((g >= 0) and (x >= 1)) implies (x <= 0.0))", pytest.approx(0.99)),
    ],
)
def test_robustness_is_the_least_margin(text, expected):
    assert (
        evaluate_formula(text, {"x": [0.03, 0.01, 0.02], "g": [-MAX_MARGIN, MAX_MARGIN, -MAX_MARGIN]})
        == expected
    )
    once = evaluate_formula(text, {"x": [0.03], "g": [-MAX_MARGIN]})
    assert once == evaluate_formula(text, {"x": [0.03, 0.03], "g": [-MAX_MARGIN, -MAX_MARGIN]})


def test_without_rtamt_the_error_names_the_package(monkeypatch):
    monkeypatch.setattr("rf_exp.constraints.stl.find_spec", lambda name: None)
    with pytest.raises(ArgumentError, match=r"pip install 'rf_exp\[stl\]'"):
        evaluate_formula("always(x <= 1)", {"x": [0.0, 0.0]})


def test_an_empty_execution_satisfies_all_checks(episodes):
    planned, execution = episodes["lift_barrier"][0]
    empty = Execution(execution.plan, ())
    assert all(agreed(empty, check) for check in planned.checked.checks)
    assert execution.clock_s[-1] == len(execution) * CONTROL_DT_S
