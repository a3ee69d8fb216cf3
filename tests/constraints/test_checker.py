"""RoboChecker from sentences to verdicts: rows, schedules, certificates and monitor."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rf_exp.constraints import CheckCode, Monitor, RoboChecker, compile_constraints
from rf_exp.constraints.checker import LOST_STEPS, TRACKING_RAD
from rf_exp.errors import ArgumentError
from rf_exp.findings import Violation
from rf_exp.robots import DEFAULT
from rf_exp.statements import (
    AvoidAgents,
    AvoidObjects,
    Before,
    ContactAt,
    Direction,
    Proposal,
    Step,
    Together,
    read_or_unparsed,
)
from rf_exp.types import ConstraintSet, Schedule, Subgoal
from tests.constraints.robots import REACHING, REST, Hand, idle, real, scene_of, walk

BAR, FOOD = real("lift_barrier"), real("place_food")
FULL = ConstraintSet("full")
LOGICAL = ConstraintSet("logical", spatial=False, temporal=False)
TEMPORAL = ConstraintSet("logical_temporal", spatial=False)
SPATIAL = ConstraintSet("logical_spatial", temporal=False)


@pytest.fixture(scope="module")
def food():
    """Scene, trajectories and proposal: agent 2 lifts the lid; agent 1 grasps and lifts the steak."""
    scene = scene_of(FOOD)
    steak_arm = Hand(FOOD, scene, 1).grasp("steak", "center").lift(0.1)
    lid_arm = Hand(FOOD, scene, 2).grasp("lid", "knob").lift(0.12)
    trajectories = steak_arm.trajectory, lid_arm.trajectory
    goals = tuple(dict.fromkeys(s.subgoal for t in trajectories for s in t.segments))
    constraints = (
        ContactAt(2, "grasp", "lid", "knob"), Direction(1, "steak"),
        Before(Step(2, "lift", "lid"), Step(1, "lift", "steak")), AvoidAgents((1,)), AvoidObjects(1),
    )  # fmt: skip
    return scene, trajectories, Proposal(goals, constraints)


def scheduled(checker: RoboChecker, trajectories, scene) -> Schedule:
    schedule = checker.schedule(checker.paths(trajectories, scene))
    assert isinstance(schedule, Schedule), schedule
    return schedule


def monitored(checker: RoboChecker, trajectories, scene) -> Monitor:
    return checker.check(
        checker.paths(trajectories, scene), scheduled(checker, trajectories, scene)
    ).monitor()


def test_check_code_prints_like_the_paper(food):
    _, _, proposal = food
    code = compile_constraints(proposal.constraints, FOOD, proposal)
    assert (
        repr(code)
        == str(code)
        == (
            "VI(Agent_2, lid, knob) and VD(Agent_1, steak, perpendicular) and "
            "VS([Agent_2, Agent_1], sequential, lift lid, lift steak) and "
            "VSO(Agent_1) and VSO(Agent_1, objects)"
        )
    )
    assert repr(CheckCode(())) == "True"


@pytest.mark.parametrize(
    ("row", "kinds"),
    [
        (LOGICAL, {"logical"}),
        (TEMPORAL, {"logical", "temporal"}),
        (SPATIAL, {"logical", "spatial"}),
        (FULL, {"logical", "spatial", "temporal"}),
    ],
)
def test_a_row_enables_its_checks(food, row, kinds):
    scene, trajectories, proposal = food
    checker = RoboChecker(FOOD, proposal, row)
    assert {check.kind for check in checker.checks} == kinds
    schedule = scheduled(checker, trajectories, scene)
    assert checker.check(checker.paths(trajectories, scene), schedule).violations == []
    if not row.temporal:
        assert len(schedule) == sum(map(len, trajectories))
    else:
        assert len(schedule) < sum(map(len, trajectories))


def test_clearance_is_checked_without_a_constraint():
    default = RoboChecker(BAR, Proposal((), ()), FULL)
    assert [repr(check) for check in default.checks] == [
        "VSO([Agent_1, Agent_2])",
        "VSO([Agent_1, Agent_2], objects)",
    ]
    assert RoboChecker(BAR, Proposal((), ()), TEMPORAL).checks == ()
    partial = RoboChecker(BAR, Proposal((), (AvoidAgents((1,)), AvoidObjects(2))), FULL)
    assert [repr(check) for check in partial.checks] == [
        "VSO(Agent_1)",
        "VSO(Agent_2, objects)",
        "VSO(Agent_1, objects)",
    ]


def test_collisions_are_violations_only_with_spatial_constraints():
    scene = scene_of(BAR)
    trajectories = walk(1, [REST, REACHING, REST], 20), walk(2, [REST, REACHING, REST], 20)
    proposal = Proposal((), ())
    unaware = RoboChecker(BAR, proposal, TEMPORAL)
    at_once = scheduled(unaware, trajectories, scene)
    assert len(at_once) == 40 and unaware.check(unaware.paths(trajectories, scene), at_once).violations == []
    aware = RoboChecker(BAR, proposal, FULL)
    (violation,) = aware.check(aware.paths(trajectories, scene), at_once).violations
    assert violation.check == "ValidateSpatialOccupancy" and violation.agents == (1, 2)
    in_time = scheduled(aware, trajectories, scene)
    assert 40 < len(in_time) < 80
    assert aware.check(aware.paths(trajectories, scene), in_time).violations == []
    turns = RoboChecker(BAR, proposal, SPATIAL)
    schedule = scheduled(turns, trajectories, scene)
    assert len(schedule) == 80
    assert turns.check(turns.paths(trajectories, scene), schedule).violations == []


def test_a_parked_arm_in_the_way_requires_another_path():
    scene = scene_of(BAR)
    qpos = scene.qpos.copy()
    qpos[1, :7] = REACHING
    scene = replace(scene, qpos=qpos)
    trajectories = walk(1, [REST, REACHING, REST], 20), idle(2, REACHING)
    checker = RoboChecker(BAR, Proposal((), ()), FULL)
    answer = checker.schedule(checker.paths(trajectories, scene))
    assert isinstance(answer, Violation)
    assert "where Agent_2 stands before and after its motion blocks Agent_1" in answer.sentence
    assert "needs another path" in answer.sentence


def test_lockstep_lists_the_joint_motions():
    goals = tuple(Subgoal(agent, "lift", "barrier") for agent in (1, 2))
    proposal = Proposal(goals, (Together((1, 2), "lift", "barrier", 0.1),))
    expected = {(frozenset({1, 2}), "lift", "barrier")}
    assert RoboChecker(BAR, proposal, FULL).lockstep == expected
    assert RoboChecker(BAR, proposal, SPATIAL).lockstep == frozenset()


def test_violations_come_earliest_first_with_evidence(food):
    scene, _, _ = food
    late = Hand(FOOD, scene, 1).grasp("steak", "center", shift_m=(0, 0, 0.05), steps=40).trajectory
    early = Hand(FOOD, scene, 2).grasp("lid", "knob", shift_m=(0, 0, 0.05)).trajectory
    constraints = (ContactAt(1, "grasp", "steak", "center"), ContactAt(2, "grasp", "lid", "knob"))
    checker = RoboChecker(FOOD, Proposal((), constraints), LOGICAL)
    together = RoboChecker(FOOD, Proposal((), ()), TEMPORAL)
    schedule = scheduled(together, (late, early), scene)
    violations = checker.check(checker.paths((late, early), scene), schedule).violations
    assert [v.agents for v in violations] == [(2,), (1,)]
    assert violations[0].check == "ValidateInteraction"
    assert violations[0].value == pytest.approx(0.05, abs=1e-3) and violations[0].bound == 0.01


def test_unparsed_sentences_are_refused():
    constraints = (read_or_unparsed("Agent_1 must feel good.", FOOD.vocabulary, "logical", (1,)),)
    with pytest.raises(ArgumentError, match=r"'Agent_1 must feel good\.' is not understood"):
        compile_constraints(constraints, BAR, Proposal((), constraints))
    with pytest.raises(ArgumentError, match=r"'Agent_1 must feel good\.' is not understood"):
        RoboChecker(BAR, Proposal((), constraints), FULL)


def test_the_certificate_is_json_with_every_check(food):
    scene, trajectories, proposal = food
    checker = RoboChecker(FOOD, proposal, FULL)
    schedule = scheduled(checker, trajectories, scene)
    checked = checker.check(checker.paths(trajectories, scene), schedule)
    certificate = json.loads(json.dumps(checked.certificate()))
    assert certificate["row"] == "full"
    assert certificate["makespan_s"] == pytest.approx(len(schedule) / 20)
    assert certificate["makespan_bound_s"] <= certificate["makespan_s"]
    assert [entry["text"] for entry in certificate["checks"][:5]] == [
        c.sentence for c in proposal.constraints
    ]
    for entry in certificate["checks"]:
        assert entry["ok"] is True
        assert {"check", "kind", "code", "value", "bound", "time_s", "reason"} <= entry.keys()
    clearance = next(entry for entry in certificate["checks"] if entry["code"] == "VSO(Agent_1)")
    assert clearance["value"] >= clearance["bound"] == certificate["margins_m"]["agents"]


@pytest.fixture
def running(food):
    """Monitor of a checked plan, its schedule, and a function from control steps to undisturbed scenes."""
    scene, trajectories, proposal = food
    checker = RoboChecker(FOOD, proposal, FULL)
    schedule = scheduled(checker, trajectories, scene)
    checked = checker.check(checker.paths(trajectories, scene), schedule)
    assert checked.violations == []
    paths = [trajectory.path() for trajectory in trajectories]

    def at(step: int, lag: int = 2, **changes):
        """The measured scene after `step` control steps; joints lag by `lag` steps, `held` is as planned."""
        qpos, poses, held = scene.qpos.copy(), dict(scene.poses), [None, None]
        for k, trajectory in enumerate(trajectories):
            position = int(schedule.positions[min(step, len(schedule)), k])
            trailing = int(schedule.positions[np.clip(step - lag, 0, len(schedule)), k])
            qpos[k, :7] = paths[k][trailing, :7]
            begin = 0
            for segment, end in zip(trajectory.segments, trajectory.knots[1:], strict=True):
                if begin < position <= end and segment.attached:
                    held[k] = segment.attached
                begin = end
        return replace(scene, step=scene.step + step, qpos=qpos, poses=poses, held=tuple(held), **changes)

    return checked.monitor(), schedule, at


def test_an_undisturbed_run_has_no_violation(running):
    monitor, schedule, at = running
    assert [v for step in range(len(schedule) + 1) if (v := monitor(at(step))) is not None] == []


def test_a_lost_object_is_detected_after_some_steps(running):
    monitor, schedule, at = running
    results = []
    for step in range(len(schedule) + 1):
        scene = at(step)
        results.append(monitor(replace(scene, held=(None, scene.held[1]))))
    violations = [v for v in results if v is not None]
    first = violations[0]
    assert first.check == "ValidateInteraction" and first.agents == (1,)
    assert first.sentence == "Agent_1, to lift steak by 0.1 m (lift), no longer holds steak"
    starts = next(step for step in range(len(schedule)) if at(step).held[0] == "steak")
    assert results.index(first) == starts + LOST_STEPS - 1


def test_a_loss_of_one_step_is_tolerated(running):
    monitor, schedule, at = running
    starts = next(step for step in range(len(schedule)) if at(step).held[1] == "lid")
    for step in range(starts, len(schedule)):
        scene = at(step)
        slipped = step % 3 == 0
        assert monitor(replace(scene, held=(scene.held[0], None)) if slipped else scene) is None


def test_an_arm_off_its_path_is_detected(running):
    monitor, _, at = running
    scene = at(10)
    qpos = scene.qpos.copy()
    qpos[1, 4] += 2 * TRACKING_RAD
    violation = monitor(replace(scene, qpos=qpos))
    assert violation is not None
    assert (violation.check, violation.agents, violation.bound) == ("Tracking", (2,), TRACKING_RAD)
    assert "rad off its path (allowed 0.15 rad): something is in its way" in violation.sentence


def test_contact_between_arms_is_detected_with_spatial_constraints(running, food):
    monitor, _, at = running
    pushed = replace(at(10), arm_contacts=((1, 2, 12.0),))
    violation = monitor(pushed)
    assert violation is not None and violation.check == "ValidateSpatialOccupancy"
    assert violation.sentence == "Agent_1 and Agent_2 touch each other with 12 N"
    scene, trajectories, proposal = food
    unaware = RoboChecker(FOOD, proposal, TEMPORAL)
    monitor = monitored(unaware, trajectories, scene)
    assert monitor(replace(scene, arm_contacts=((1, 2, 12.0),))) is None


def test_colliding_arms_stop_in_every_row(food):
    scene, trajectories, proposal = food
    unaware = RoboChecker(FOOD, proposal, LOGICAL)
    monitor = monitored(unaware, trajectories, scene)
    violation = monitor(replace(scene, arm_contacts=((1, 2, DEFAULT.reflex_n + 1.0),)))
    assert violation is not None
    assert (violation.check, violation.agents, violation.bound) == ("Collision", (1, 2), DEFAULT.reflex_n)
    assert violation.sentence == (
        "Agent_1, to grasp steak at center (move), and Agent_2, to grasp lid at knob (move), "
        "hit each other with 21 N (arms stop at 20 N)"
    )


def test_an_arm_that_pushes_another_object_stops_in_every_row(food):
    scene, trajectories, proposal = food
    unaware = RoboChecker(FOOD, proposal, LOGICAL)
    monitor = monitored(unaware, trajectories, scene)
    hard = np.array([0.0, 0.0, -DEFAULT.reflex_n - 1.0])
    assert monitor(replace(scene, finger_forces={(1, "steak"): hard, (2, "pot"): 0.9 * hard})) is None
    violation = monitor(replace(scene, finger_forces={(1, "steak"): 2 * hard, (2, "pot"): hard}))
    assert violation is not None and (violation.check, violation.agents) == ("Collision", (2,))
    assert violation.sentence == (
        "Agent_2, to grasp lid at knob (move), pushes pot with 21 N (arms stop at 20 N)"
    )


def test_times_are_on_the_clock_of_the_episode():
    """For plans that begin at 2.0 s: times of planned violations and of failed scheduling."""
    scene, late = scene_of(BAR), scene_of(BAR, step=40)
    trajectories = walk(1, [REST, REACHING, REST], 20), walk(2, [REST, REACHING, REST], 20)
    first = {}
    for now in (scene, late):
        unaware, aware = (RoboChecker(BAR, Proposal((), ()), row) for row in (TEMPORAL, FULL))
        checked = aware.check(aware.paths(trajectories, now), scheduled(unaware, trajectories, now))
        (near,) = checked.violations
        blocked = (walk(1, [REST, REACHING], 20), walk(2, [REST, REACHING], 20))
        refused = aware.schedule(aware.paths(blocked, now))
        assert isinstance(refused, Violation) and refused.cause == "space" and refused.agents == (1, 2)
        first[now.step] = np.array([near.time_s, refused.time_s])
        assert checked.evidence[-1].time_s >= now.step / 20
    np.testing.assert_allclose(first[40] - first[0], 2.0)
