"""Signal temporal logic: every kind of check has a form, and rtamt's verdict on it is the monitor's."""

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
    """The verdict on which both agree."""
    found = all(each.holds for each in evaluate_check(execution, check))
    assert found == monitor_verdict(execution, check), (check, evaluate_check(execution, check))
    return found


def check_for(made: Planned, execution: Execution, stated: Statement) -> Check:
    return compile_statement(stated, execution.plan.task, made.proposal)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_on_a_real_episode_both_agree_on_every_check(episodes, name):
    for made, execution in episodes[name]:
        assert len(execution) > 20 and all(agreed(execution, check) for check in made.checked.checks)
        times = [scene.step for scene in execution.scenes]
        assert times == list(range(times[0], times[0] + len(execution)))
        assert times[0] == execution.plan.scene.step + 1
        forms = [check.stl(execution.plan.task) for check in made.checked.checks]
        said = {(signal.name, signal.description) for form in forms for signal in form.signals}
        assert len(said) == len(signals(execution, made.checked.checks))  # the same name is the same number


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_what_is_left_of_a_clearance_is_what_the_plan_had_less_its_bound(episodes, name):
    """Of things, and of the table: neither hides the other."""
    seen = 0
    for made, execution in episodes[name]:
        for check, evidence in zip(made.checked.checks, made.checked.evidence, strict=True):
            if not isinstance(check, AvoidObjectsCheck):
                continue
            things, table = evaluate_check(execution, check)
            low_m = [
                lowest_m(execution.plan.paths.swept[agent - 1])[execution.positions(agent)].min()
                for agent in check.agents
            ]
            assert table.robustness == pytest.approx(min(low_m), abs=1e-9)
            if things.applies:
                left_m = evidence.value - evidence.bound  # with the beginning, and what was not carried out
                assert things.robustness >= left_m - 1e-9
                if evidence.time_s <= execution.plan.begins_s + execution.clock_s[-1]:
                    assert things.robustness == pytest.approx(left_m, abs=2e-3)
                seen += table.robustness < things.robustness - 0.01
    assert seen or name == "lift_barrier"  # nothing lies still on its table


# statement, field of its check, bound of the field for a worst value, unit steps beyond the boundary
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
def test_a_limit_is_judged_alike_at_below_and_above_what_was_measured(episodes, name, stated, field, bound):
    made, execution = episodes[name][0]
    check: Any = check_for(made, execution, stated)  # a frozen dataclass
    values = [each.value for each in execution.measured(check) if each is not None]
    values = values or [check.planned(execution.plan).value]
    least = field in ("at_least_m", "wait_s") or getattr(check, "side", "") == "above"
    at = bound(min(values) if least else max(values))
    inside, outside = (-1e-6, 1e-6) if least else (1e-6, -1e-6)
    agreed(execution, replace(check, **{field: at}))
    assert agreed(execution, replace(check, **{field: at + inside}))
    assert not agreed(execution, replace(check, **{field: at + outside}))
    robust = evaluate_check(execution, replace(check, **{field: at + inside}))
    assert robust[0].robustness == pytest.approx(1e-6, rel=0.5)


def changed(execution: Execution, **values: Any) -> Execution:
    """The same with something else in every scene; a function is asked for each of them."""
    scenes = []
    for scene in execution.scenes:
        found = {name: each(scene) if callable(each) else each for name, each in values.items()}
        scenes.append(replace(scene, **found))
    return Execution(execution.plan, scenes)


@pytest.mark.slow
@pytest.mark.parametrize("far_m", [0.0, POSITION_MEASURED_M - 1e-6, POSITION_MEASURED_M, 0.031])
def test_where_the_gripper_meets_an_object(episodes, far_m):
    made, execution = episodes["lift_barrier"][0]
    check = check_for(made, execution, ContactAt(1, "grasp", "barrier", "left"))
    point = execution.plan.task.asset("barrier").points["left"].object_from_tcp

    def poses(scene: Scene) -> dict[str, np.ndarray]:
        tcp = execution.plan.planning_scene.arms[0].tcp(scene.qpos[0])
        aside = transform((far_m, 0, 0)) @ tcp @ np.linalg.inv(point)
        return {**scene.poses, "barrier": aside}

    verdict = agreed(changed(execution, poses=poses), check)
    if far_m != POSITION_MEASURED_M:  # there the last bit decides, for both alike
        assert verdict == (far_m < POSITION_MEASURED_M)


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [0.0, ANGLE_MEASURED_DEG - 3, ANGLE_MEASURED_DEG + 3])
def test_how_the_gripper_meets_an_object(episodes, turn_deg):
    made, execution = episodes["lift_barrier"][0]
    turn = transform((0, 0, 0), Rotation.from_euler("z", turn_deg, degrees=True))
    check = check_for(made, execution, Direction(1, "barrier"))
    turned = changed(execution, poses=lambda scene: {"barrier": scene.poses["barrier"] @ turn})
    assert agreed(turned, check) == (turn_deg < ANGLE_MEASURED_DEG)
    throughout = check_for(made, execution, Direction(1, "barrier", "vertical", "grasp"))
    agreed(execution, throughout)


def test_several_that_raise_one_thing(episodes):
    made, execution = episodes["lift_barrier"][-1]
    check = check_for(made, execution, SameHeight((1, 2)))
    assert agreed(execution, check) and evaluate_check(execution, check)[0].applies
    bent = changed(execution, qpos=lambda scene: scene.qpos + np.eye(2, 1) @ np.eye(1, 9, 3) * 0.1)
    assert not agreed(bent, check)


def test_what_is_put_down(episodes):
    made, execution = episodes["place_food"][0]
    check = check_for(made, execution, PlaceAt(1, "steak", "pot", "inside"))
    assert agreed(execution, check) and evaluate_check(execution, check)[0].applies
    paths = execution.plan.paths
    poses = {**paths.scene.poses, "pot": transform((0.2, 0, 0)) @ paths.scene.poses["pot"]}
    elsewhere = Paths(paths.task, paths.constraint_set, replace(paths.scene, poses=poses), paths.trajectories)
    assert not agreed(Execution(Plan(elsewhere, execution.plan.schedule), execution.scenes), check)


ACROSS = np.array([0.0, 1.1, 0.0, -0.8, 0.0, 1.9, 0.785])  # stretched out over the middle
DOWN = REACHING + np.array([0, 0.5, 0, 0, 0, 0, 0])  # on the table


def reaching(goal: NDArray[np.float64], *agents: int) -> Execution:
    """Some of two arms go to a position, one after the other."""
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
    execution = changed(reaching(REACHING, *agents), arm_contacts=((2, 1, force_n),))
    check = compile_statement(AvoidAgents((1, 2)), execution.plan.task, Proposal((), ()))
    assert agreed(execution, check) == holds


@pytest.mark.parametrize(("agents", "holds"), [((), True), ((1,), False)])
def test_an_arm_that_comes_too_near_to_things(agents, holds):
    execution = reaching(DOWN, *agents)
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
    execution = reaching(ACROSS, 1)
    zone = KeepOut(1, low_m, tuple(side + 0.4 for side in low_m), **more)
    assert agreed(execution, compile_statement(zone, execution.plan.task, Proposal((), ()))) == holds


def test_a_permission_says_that_it_has_no_formula(episodes):
    made, execution = episodes["place_food"][0]
    form = check_for(made, execution, ShareSpace((1, 2))).stl(execution.plan.task)
    assert not form.formulas and "permission" in form.no_formulas_reason


def test_every_kind_of_statement_has_a_form_and_a_case_here(episodes):
    """A kind that is added to the package needs both."""
    cases = {type(stated) for _, stated, *_ in LIMITS}
    cases |= {ContactAt, Direction, SameHeight, PlaceAt, AvoidAgents, AvoidObjects, KeepOut, ShareSpace}
    ours = {kind: check for kind, check in checked_kinds().items() if "rf_exp." in kind.__module__}
    assert cases == ours.keys()
    assert all(check.stl is not Check.stl for check in ours.values())


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


def test_without_rtamt_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setattr("rf_exp.constraints.stl.find_spec", lambda name: None)
    with pytest.raises(ArgumentError, match=r"pip install 'rf_exp\[stl\]'"):
        evaluate_formula("always(x <= 1)", {"x": [0.0, 0.0]})


def test_nothing_that_was_carried_out_is_judged_to_hold(episodes):
    made, execution = episodes["lift_barrier"][0]
    nothing = Execution(execution.plan, ())
    assert all(agreed(nothing, check) for check in made.checked.checks)
    assert execution.clock_s[-1] == len(execution) * CONTROL_DT_S
