"""Named faults of plans: detected before any motion, explained and repaired, in the real simulator."""

from functools import cache

import numpy as np
import pytest

from rf_exp.datagen import EpisodeGenerator, NullObserver, Settings, make_episode
from rf_exp.datagen.brain import (
    FAULTS,
    FaultyBrain,
    FaultySpec,
    Question,
    fault_applies,
    faults_for,
    from_json,
)
from rf_exp.errors import ArgumentError
from rf_exp.findings import Cause, CheckName
from rf_exp.sim import Simulator
from rf_exp.statements import Before, UnparsedStatement, read
from rf_exp.types import NO_PICTURES, ConstraintSet
from tests.conftest import CONF, experiment, read_task
from tests.scenes import rejection, start_scene

FULL = ConstraintSet("full")


class StepRecorder(NullObserver):
    """Observer that records the number of steps, and the violations with the step at which each occurred."""

    def __init__(self):
        self.rejected_at, self.reasons, self.steps = [], [], 0
        self.planned_at = []

    def planned(self, plan):
        self.planned_at.append(self.steps)

    def rejected(self, violation):
        self.rejected_at.append(self.steps)
        self.reasons.append(violation.sentence)

    def stepped(self, scene, action, pictures):
        self.steps += 1


@pytest.fixture(scope="module")
def simulators():
    with (
        Simulator(read_task("lift_barrier"), render=False) as lift,
        Simulator(read_task("place_food"), render=False) as place,
    ):
        yield {"lift_barrier": lift, "place_food": place}


def make_faulty(world, fault):
    recorder, brain = StepRecorder(), FaultyBrain(fault, seed=0)
    outcome = EpisodeGenerator(
        Settings.configured(world.task, FULL, FaultySpec(fault)), world, brain, recorder
    ).make(0)
    return outcome, recorder, brain


@pytest.fixture(scope="module")
def cached_outcome(simulators):
    """`make_faulty` by task name and fault, cached for tests that share a fault."""
    return cache(lambda name, fault: make_faulty(simulators[name], fault))


def faults_of(name, breaks):
    task = read_task(name)
    scene = start_scene(task, 0)
    return [fault for fault in FAULTS if FAULTS[fault].breaks is breaks and fault_applies(fault, task, scene)]


CASES = [("lift_barrier", fault) for fault in (*faults_of("lift_barrier", True), "uneven_height")]
CASES += [
    pytest.param("place_food", fault, marks=pytest.mark.slow)
    for fault in faults_of("place_food", True)
    if fault not in faults_of("lift_barrier", True)
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fault"), CASES)
def test_a_fault_that_breaks_a_rule_is_found_before_motion_and_repaired(name, fault, cached_outcome):
    outcome, recorder, brain = cached_outcome(name, fault)
    assert brain.inserted and outcome.success and outcome.attempts == 2
    (stopped_at,) = recorder.rejected_at
    assert stopped_at in (0, *recorder.planned_at)  # nothing moved between the proposal and its rejection
    assert recorder.reasons[0]


REASONS = {
    "wrong_point": "Agent_",
    "unknown_point": "no interaction point 'nowhere'; available: left, right",
    "wrong_direction": "90 deg off the horizontal",
    "unknown_agent": "unknown agent 'Agent_3'",
    "missing_object": "no object 'second_barrier' in subgoal 'grasp second_barrier",
    "unreadable_constraint": "is not understood: the grammar cannot read 'mind manners'",
    "lost_synchronisation": "contradict one another",
    "impossible_deadline": "cannot be done within 0.1 s",
    "unreachable_target": "does not reach that high",
    "forbidden_zone": "enters the keep-out zone",
    "missing_subgoal": "its subgoals: none",
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", REASONS)
def test_the_reason_describes_the_fault(fault, cached_outcome):
    _, recorder, _ = cached_outcome("lift_barrier", fault)
    assert REASONS[fault] in recorder.reasons[0]


@pytest.mark.slow
def test_a_missing_constraint_causes_no_rejection(cached_outcome):
    outcome, recorder, brain = cached_outcome("lift_barrier", "missing_constraint")
    assert brain.inserted and outcome.success and not recorder.reasons


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_applies_to_some_scene_and_is_documented(fault):
    assert (FAULTS[fault].insert.__doc__ or "").endswith(".")
    lift = read_task("lift_barrier")
    held = start_scene(lift, 0)
    held = type(held)(**{**held.__dict__, "held": ("barrier", "barrier")})
    place = read_task("place_food")
    scenes = [(lift, start_scene(lift, 0)), (lift, held), (place, start_scene(place, 0))]
    assert any(fault_applies(fault, task, scene) for task, scene in scenes)


def test_an_applicable_fault_changes_the_plan_and_is_determined_by_the_seed(task):
    """Holds for all tasks: no fault crashes, and the seed determines the changed plan."""
    scene = start_scene(task, 0)
    correct_plan = task.module.plan(scene, task)
    for fault in FAULTS.values():
        question = Question(task, scene, {})
        first, second = (fault.change(correct_plan, question, np.random.default_rng(3)) for _ in range(2))
        assert first == second and first != correct_plan


def test_a_fault_is_refused_for_tasks_to_which_it_does_not_apply(task):
    """Every fault applies to the plans of a task or is refused; the error lists those that apply."""
    known = faults_for(task)
    assert known
    for fault in FAULTS:
        if fault in known:
            FaultySpec(fault).fits(task)
            continue
        with pytest.raises(ArgumentError) as refused:
            FaultySpec(fault).fits(task)
        assert str(refused.value) == (
            f"brain.fault={fault} has no place in the plans of {task.name}; "
            f"those that have: {', '.join(known)}"
        )
    scenes = [start_scene(task, seed) for seed in range(10, 20)]
    applicable = {tuple(fault for fault in FAULTS if fault_applies(fault, task, scene)) for scene in scenes}
    assert len(applicable) == 1, "whether a fault applies depends on the scene"
    assert set(applicable.pop()) <= set(known)


def test_a_fault_that_applies_later_in_the_episode_is_accepted():
    """Lifts are proposed only once the barrier is held."""
    lift = read_task("lift_barrier")
    assert not fault_applies("uneven_height", lift, start_scene(lift, 0))
    assert "uneven_height" in faults_for(lift)


def test_an_experiment_with_an_inapplicable_fault_is_refused_at_once():
    with pytest.raises(
        ArgumentError, match=r"brain.fault=wrong_point has no place in the plans of place_food"
    ):
        experiment("task=place_food", "brain=faulty", "brain.fault=wrong_point")
    experiment("task=lift_barrier", "brain=faulty")
    experiment("task=place_food", "brain=faulty", "brain.fault=wrong_point", "stages=[report]")


@pytest.mark.slow
def test_a_fault_that_was_never_inserted_is_reported():
    settings = Settings.configured(read_task("stack_cube"), FULL, FaultySpec("wrong_point"))
    outcome = make_episode(settings, NO_PICTURES, 0)
    assert not outcome.success and outcome.episode is None
    assert outcome.account.kind == outcome.reason
    assert outcome.reason.startswith("the fault wrong_point was not planted")


@pytest.mark.parametrize("name", ["pass_shoe", "long_pipeline_delivery"])
def test_a_forbidden_zone_is_on_the_way_of_the_agent(name):
    """Not where an object starts that another agent brings: no agent would have to enter that zone."""
    task = read_task(name)
    scene = start_scene(task, 0)
    correct_plan, brought = task.module.plan(scene, task), set()
    for constraint in correct_plan.constraints:
        if isinstance(constraint, Before) and constraint.first.object == constraint.then.object:
            brought.add((constraint.then.agent, constraint.then.object))
    assert brought
    for seed in range(20):
        question, rng = Question(task, scene, {}), np.random.default_rng(seed)
        changed = FAULTS["forbidden_zone"].change(correct_plan, question, rng)
        assert changed is not None
        (agent,) = changed.constraints[-1].agents
        objects = {s.object for s in correct_plan.subgoals_of(agent) if s.verb in ("grasp", "press", "shut")}
        assert not {(agent, name) for name in objects} <= brought


def test_after_feedback_it_answers_as_scripted(lift_barrier):
    scene = start_scene(lift_barrier, 0)
    brain = FaultySpec("wrong_point").make(lift_barrier, FULL, 0)
    correct_plan = lift_barrier.module.plan(scene, lift_barrier)
    first = from_json(brain.answer(Question(lift_barrier, scene, {})), lift_barrier)
    assert first != correct_plan and first.constraints == correct_plan.constraints
    found = rejection(lift_barrier, "wrong_point")
    assert found.check is CheckName.CODE and found.cause is Cause.ANSWER and not found.measured
    second = Question(lift_barrier, scene, {}, feedback=(found,))
    assert from_json(brain.answer(second), lift_barrier) == correct_plan


@pytest.mark.slow
def test_only_the_first_feedback_is_about_the_fault():
    """It names two arms, as for many faults, but neither moves aside; later feedback has an effect."""
    task = read_task("three_robots_stack_cube")
    scene, brain = start_scene(task, 0), FaultySpec("through_arm").make(task, FULL, 0)
    brain.answer(Question(task, scene, {}))
    assert brain.inserted
    found = rejection(task, "through_arm")
    assert found.cause is Cause.SPACE and len(found.agents) == 2
    later = Question(task, scene, {}, feedback=(found,))
    assert from_json(brain.answer(later), task) == task.module.plan(scene, task)
    (aside,) = from_json(brain.answer(later), task).subgoals
    assert aside.verb == "aside" and aside.agent in found.agents


def test_the_documentation_lists_every_fault():
    rows = [line for line in (CONF.parent / "docs" / "brains.md").read_text().splitlines() if "|" in line]
    assert {fault for fault in FAULTS if any(row.startswith(f"| `{fault}`") for row in rows)} == set(FAULTS)


def test_an_unknown_fault_error_lists_the_known_faults():
    with pytest.raises(ArgumentError, match="unknown fault 'bad_luck'; available: circular_order, forb"):
        FaultySpec("bad_luck")


@pytest.mark.slow
def test_every_sentence_of_plans_and_faults_is_parsed_to_its_statement(task):
    """For all tasks: the sentences of constraints of plans and faults are parsed to the same constraints."""
    scene = start_scene(task, 0)
    plan = task.module.plan(scene, task)
    changed = (f.change(plan, Question(task, scene, {}), np.random.default_rng(0)) for f in FAULTS.values())
    for proposal in (plan, *(each for each in changed if each is not None)):
        for stated in proposal.constraints:
            if isinstance(stated, UnparsedStatement) or not set(stated.agents) <= set(task.agents):
                assert proposal is not plan
            else:
                assert read(stated.sentence, task.vocabulary) == stated
