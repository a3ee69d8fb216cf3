"""The generation loop in the real simulator: feedback, replanning, budgets and reasons of failure."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rf_exp.datagen import EpisodeGenerator, NullObserver, Settings, make_episode
from rf_exp.datagen.brain import ScriptedBrain, ScriptedSpec, from_json, to_json
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import CheckName
from rf_exp.sim import Simulator
from rf_exp.tasks import SuccessEvaluator
from rf_exp.types import CONTROL_HZ, NO_PICTURES, UNITS, ConstraintSet, Subgoal
from tests.conftest import read_task

FULL = ConstraintSet("full")
LOGICAL = ConstraintSet("logical", spatial=False, temporal=False)
SPATIAL = ConstraintSet("logical_spatial", temporal=False)
BLIND = ConstraintSet("logical_temporal", spatial=False)


@pytest.fixture(scope="module")
def lift_sim():
    with Simulator(read_task("lift_barrier"), render=False) as world:
        yield world


class MistakenBrain(ScriptedBrain):
    """Scripted brain that changes `times` answers after `well` unchanged ones, and records its questions."""

    def __init__(self, change, times=1, well=0):
        self.change, self.changed, self.questions = change, range(well + 1, well + times + 1), []

    def answer(self, question):
        self.questions.append(question)
        text = super().answer(question)
        if len(self.questions) not in self.changed:
            return text
        changed = self.change(from_json(text, question.task))
        return changed if isinstance(changed, str) else to_json(changed)


class PlanRecorder(NullObserver):
    def __init__(self):
        self.rejections, self.plans, self.begins, self.steps = [], [], [], 0

    def planned(self, plan):
        self.plans.append(plan)
        self.begins.append(self.steps)

    def rejected(self, violation):
        self.rejections.append(violation)

    def stepped(self, scene, action, pictures):
        self.steps += 1


def both_grasp_left(proposal):
    """Agent 2 also grasps the left end, which is that of Agent 1; the constraints are unchanged."""
    return replace(proposal, subgoals=(proposal.subgoals[0], Subgoal(2, "grasp", "barrier", "left")))


def settings(task, row=FULL, **keywords):
    return Settings.configured(task, row, ScriptedSpec(), **keywords)


def test_an_episode_succeeds_and_carries_its_certificate(lift_sim):
    recorder = PlanRecorder()
    outcome = EpisodeGenerator(settings(lift_sim.task), lift_sim, ScriptedBrain(), recorder).make(0)
    episode = outcome.episode
    assert outcome.success and outcome.success_paper and outcome.reason == "" and outcome.attempts == 1
    assert episode is not None and outcome.steps == recorder.steps == len(episode.qpos)
    assert episode.qpos.shape[1:] == (2, 9) and episode.action.shape[1:] == (2, 8)
    rounds = json.loads(json.dumps(episode.certificate))["rounds"]
    assert [len(each["checks"]) > 0 and all(c["ok"] for c in each["checks"]) for each in rounds] == [
        True,
        True,
    ]
    assert "VI(Agent_1, barrier, left)" in rounds[0]["check_code"]


@pytest.mark.slow
def test_the_expert_succeeds_within_the_joint_limits_and_its_actions_can_be_replayed(task):
    with Simulator(task, render=False) as world:
        configured = settings(task)
        episode = EpisodeGenerator(configured, world, ScriptedBrain()).make(1).episode
        assert episode is not None
        commands = episode.action[:, :, :7].astype(float)
        velocity = np.diff(commands, axis=0) * CONTROL_HZ
        assert np.abs(velocity).max() <= 1.001 * configured.limits.velocity_rad_s
        acceleration = np.diff(velocity, axis=0) * CONTROL_HZ
        assert np.abs(acceleration).max() <= 1.01 * configured.limits.acceleration_rad_s2
        assert np.abs(episode.qvel[:, :, :7]).max() <= 1.1 * configured.limits.velocity_rad_s
        assert np.abs(episode.qpos[1:, :, :7] - commands[:-1]).max() < 0.12

        scene = world.reset(1)
        judge = SuccessEvaluator(task, scene)
        for qpos, action in zip(episode.qpos, episode.action, strict=True):
            np.testing.assert_array_equal(scene.qpos.astype(np.float32), qpos)
            scene = world.step(action.astype(float))
            verdict = judge(scene)
        assert verdict.success


@pytest.mark.slow
def test_colliding_arms_relax_move_aside_and_go_on():
    """Without spatial constraints Agent_3 and Agent_2 meet over the stack (seed 0)."""
    task, recorder = read_task("three_robots_stack_cube"), PlanRecorder()
    with Simulator(task, render=False) as world:
        maker = EpisodeGenerator(settings(task, BLIND), world, ScriptedBrain(), recorder)
        outcome = maker.make(0)
    assert outcome.success and outcome.attempts == 1 + len(recorder.rejections) >= 2
    for violation in recorder.rejections:
        assert violation.check is CheckName.COLLISION and len(violation.agents) == 2
    episode, hit = outcome.episode, recorder.rejections[0]
    assert episode is not None
    aside_plan = next(k for k, plan in enumerate(recorder.plans) if plan.proposal.subgoals[0].verb == "aside")
    assert {subgoal.agent for subgoal in recorder.plans[aside_plan].proposal.subgoals} == set(hit.agents)
    begins, behind_rad = recorder.begins[aside_plan], episode.action[:-1, :, :7] - episode.qpos[1:, :, :7]
    assert begins > hit.time_s * CONTROL_HZ
    for agent in hit.agents:  # relaxed: the commands are the measured joints
        assert np.abs(behind_rad[begins - 1, agent - 1]).max() < 0.02


@pytest.mark.slow
def test_an_arm_in_the_way_of_a_lift_leaves_before_the_lift():
    """The photographer waits over the camera; without spatial constraints it is hit by the lifted camera."""
    task = read_task("take_photo")
    with Simulator(task, render=False) as world:
        plans = {}
        for row in (FULL, SPATIAL, BLIND):
            recorder = PlanRecorder()
            outcome = EpisodeGenerator(settings(task, row), world, ScriptedBrain(), recorder).make(2)
            assert outcome.success and outcome.attempts == (2 if row is BLIND else 1)
            plans[row] = recorder.plans[1]  # the first grasps
    for row in (FULL, SPATIAL):
        plan = plans[row]
        positions, waiting = plan.schedule.positions, len(plan.trajectories[3])
        assert waiting > 0 and not plan.proposal.subgoals_of(4)
        if row is SPATIAL:  # arms take turns
            assert (positions[positions[:, 0] > 0, 3] == waiting).all()
    assert len(plans[BLIND].trajectories[3]) == 0


def test_a_wrong_contact_point_is_caught_before_anything_moves_and_repaired(lift_sim):
    recorder, brain = PlanRecorder(), MistakenBrain(both_grasp_left)
    outcome = EpisodeGenerator(settings(lift_sim.task), lift_sim, brain, recorder).make(0)
    assert outcome.success and outcome.attempts == 2
    (violation,) = recorder.rejections
    assert (violation.check, violation.measured, violation.time_s) == (CheckName.CODE, False, 0.0)
    assert "Agent_2" in violation.sentence
    second = brain.questions[1]
    assert second.feedback == (violation,) and second.scene.step == 0


def test_a_mistake_in_mid_episode_has_the_time_of_the_episode(lift_sim):
    recorder, brain = PlanRecorder(), MistakenBrain(lambda proposal: "no json", well=1)
    outcome = EpisodeGenerator(settings(lift_sim.task), lift_sim, brain, recorder).make(0)
    assert outcome.success and outcome.attempts == 2
    (violation,), began = recorder.rejections, recorder.begins[1]  # the lift, once both have grasped
    assert violation.time_s == began / CONTROL_HZ > 1.0
    assert [question.scene.step for question in brain.questions[:3]] == [0, began, began]


@pytest.mark.slow
@pytest.mark.parametrize(
    "answer", ["no json", '{"Subgoals": {"Agent_9": "home"}}', '{"Subgoals": {"Agent_1": "fly"}}']
)
def test_a_bad_answer_is_feedback_too(lift_sim, answer):
    brain = MistakenBrain(lambda proposal: answer)
    outcome = EpisodeGenerator(settings(lift_sim.task), lift_sim, brain).make(0)
    assert outcome.success and outcome.attempts == 2
    assert brain.questions[1].feedback[0].check == "RoboBrain"


def test_the_budget_of_attempts_ends_an_episode_with_its_reason(lift_sim):
    brain = MistakenBrain(lambda proposal: "never any json", times=99)
    outcome = EpisodeGenerator(settings(lift_sim.task, attempts=3), lift_sim, brain).make(0)
    assert not outcome.success and outcome.episode is None
    assert outcome.attempts == 3 == len(brain.questions)
    assert "not the expected JSON" in outcome.reason and outcome.steps == 0


@pytest.mark.slow
def test_arms_take_turns_without_a_model_of_time(lift_sim):
    recorder = PlanRecorder()
    EpisodeGenerator(settings(lift_sim.task, LOGICAL), lift_sim, ScriptedBrain(), recorder).make(0)
    for plan in recorder.plans:
        moves = np.diff(plan.schedule.positions, axis=0)
        assert (moves.sum(axis=1) == 1).all()
    full = PlanRecorder()
    EpisodeGenerator(settings(lift_sim.task), lift_sim, ScriptedBrain(), full).make(0)
    assert (np.diff(full.plans[1].schedule.positions, axis=0) == 1).all()  # the lift is one joint motion


@pytest.mark.slow
def test_a_heavy_barrier_is_dropped_in_turns_and_lifted_together(lift_barrier):
    """Effect of lost synchronisation (paper, section 4.3): one arm alone slips, and the barrier falls."""
    heavy = replace(lift_barrier, randomisation=replace(lift_barrier.randomisation, mass_scale=1.0))
    seed = next(seed for seed in range(1000) if heavy.start(seed).masses_kg["barrier"] > 9.3)
    with Simulator(heavy, render=False) as world:
        together, turns = (
            EpisodeGenerator(Settings.configured(heavy, row, ScriptedSpec()), world, ScriptedBrain()).make(
                seed
            )
            for row in (FULL, ConstraintSet("logical_spatial", temporal=False))
        )
    assert together.success
    assert not turns.success and "Agent" in turns.reason


@pytest.mark.slow
def test_the_expert_continues_after_given_actions(lift_sim):
    """The leading steps are stored as executed, with subgoal -1."""
    setting = settings(read_task("lift_barrier"))
    full_episode = EpisodeGenerator(setting, lift_sim, ScriptedBrain()).make(5).episode
    assert full_episode is not None
    lead = full_episode.action[:40].astype(float)
    lead[20:, :, 0] += 0.1 * np.linspace(0, 1, 20)[:, None]  # away from the plan
    subgoal_texts: Any = full_episode.certificate["subgoals"]
    outcome = EpisodeGenerator(setting, lift_sim, ScriptedBrain()).make(5, lead, subgoal_texts)
    episode = outcome.episode
    assert outcome.attempts == 1 and episode is not None and episode.subgoal is not None
    np.testing.assert_array_equal(episode.action[:40], lead.astype(np.float32))
    assert (episode.subgoal[:40] == -1).all() and (episode.subgoal[40:] >= 0).all()
    assert episode.certificate["subgoals"] == subgoal_texts
    moved = np.abs(np.diff(episode.action[39:, :, :7], axis=0)).max(axis=(1, 2))
    assert moved.max() < 1.1 * setting.limits.velocity_rad_s / CONTROL_HZ  # no jump at the transition


def test_an_error_within_an_episode_names_its_seed_and_keeps_its_class(lift_barrier, monkeypatch):
    def stopped(*_: object) -> None:
        raise StageError("no connection")

    monkeypatch.setattr(ScriptedBrain, "answer", stopped)
    with pytest.raises(StageError, match="seed 7: no connection"):
        make_episode(settings(lift_barrier), NO_PICTURES, 7)


def test_attempts_must_be_positive(lift_barrier):
    with pytest.raises(ArgumentError, match="attempts is 0; at least 1"):
        settings(lift_barrier, attempts=0)


def test_conditions_are_stored_with_their_values_whether_met_or_not(lift_sim):
    settings = Settings.configured(lift_sim.task, FULL, ScriptedSpec())
    outcome = EpisodeGenerator(settings, lift_sim, settings.make_brain(0)).make(0)
    assert outcome.episode is not None
    judged = outcome.episode.judged
    assert judged is not None
    raised = next(k for k, name in enumerate(judged.names) if judged.unit[0, k] == UNITS.index("m"))
    value, bound, holds = judged.value[:, raised], judged.bound[:, raised], judged.holds[:, raised]
    assert not holds[0] and holds[-1]
    assert len(set(bound.tolist())) == 1 and (holds == (value > bound)).all()
    assert len(set(value[~holds].tolist())) > 2  # it rises before it is high enough
