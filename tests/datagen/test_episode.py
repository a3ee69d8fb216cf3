"""The generation loop in the real simulator: feedback, replanning, budgets, honest reasons."""

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
def lift_world():
    with Simulator(read_task("lift_barrier"), render=False) as world:
        yield world


class Mistaken(ScriptedBrain):
    """Changes some answers, the first unless others have gone well, and keeps the questions it was asked."""

    def __init__(self, change, times=1, well=0):
        self.change, self.changed, self.questions = change, range(well + 1, well + times + 1), []

    def answer(self, question):
        self.questions.append(question)
        text = super().answer(question)
        if len(self.questions) not in self.changed:
            return text
        changed = self.change(from_json(text, question.task))
        return changed if isinstance(changed, str) else to_json(changed)


class Watcher(NullObserver):
    def __init__(self):
        self.rejections, self.plans, self.begins, self.steps = [], [], [], 0

    def planned(self, plan):
        self.plans.append(plan)
        self.begins.append(self.steps)

    def rejected(self, violation):
        self.rejections.append(violation)

    def stepped(self, scene, action, pictures):
        self.steps += 1


def both_left(proposal):
    """Agent 2 is sent to the end that Agent 1 is to grasp, with the constraints as they were."""
    return replace(proposal, subgoals=(proposal.subgoals[0], Subgoal(2, "grasp", "barrier", "left")))


def settings(task, row=FULL, **keywords):
    return Settings.configured(task, row, ScriptedSpec(), **keywords)


def test_an_episode_succeeds_and_carries_its_certificate(lift_world):
    watcher = Watcher()
    outcome = EpisodeGenerator(settings(lift_world.task), lift_world, ScriptedBrain(), watcher).make(0)
    episode = outcome.episode
    assert outcome.success and outcome.success_paper and outcome.reason == "" and outcome.attempts == 1
    assert episode is not None and outcome.steps == watcher.steps == len(episode.qpos)
    assert episode.qpos.shape[1:] == (2, 9) and episode.action.shape[1:] == (2, 8)
    rounds = json.loads(json.dumps(episode.certificate))["rounds"]
    assert [len(each["checks"]) > 0 and all(c["ok"] for c in each["checks"]) for each in rounds] == [
        True,
        True,
    ]
    assert "VI(Agent_1, barrier, left)" in rounds[0]["check_code"]


@pytest.mark.slow
def test_the_expert_succeeds_within_the_joint_limits_and_its_actions_play_again(task):
    with Simulator(task, render=False) as world:
        made = settings(task)
        episode = EpisodeGenerator(made, world, ScriptedBrain()).make(1).episode
        assert episode is not None
        commands = episode.action[:, :, :7].astype(float)
        velocity = np.diff(commands, axis=0) * CONTROL_HZ
        assert np.abs(velocity).max() <= 1.001 * made.limits.velocity_rad_s
        acceleration = np.diff(velocity, axis=0) * CONTROL_HZ
        assert np.abs(acceleration).max() <= 1.01 * made.limits.acceleration_rad_s2
        assert np.abs(episode.qvel[:, :, :7]).max() <= 1.1 * made.limits.velocity_rad_s
        assert np.abs(episode.qpos[1:, :, :7] - commands[:-1]).max() < 0.12

        scene = world.reset(1)
        judge = SuccessEvaluator(task, scene)
        for qpos, action in zip(episode.qpos, episode.action, strict=True):
            np.testing.assert_array_equal(scene.qpos.astype(np.float32), qpos)
            scene = world.step(action.astype(float))
            verdict = judge(scene)
        assert verdict.success


@pytest.mark.slow
def test_arms_that_hit_each_other_stop_pushing_draw_aside_and_go_on():
    """Without spatial constraints Agent_3 and Agent_2 meet over the stack (seed 0)."""
    task, watcher = read_task("three_robots_stack_cube"), Watcher()
    with Simulator(task, render=False) as world:
        maker = EpisodeGenerator(settings(task, BLIND), world, ScriptedBrain(), watcher)
        outcome = maker.make(0)
    assert outcome.success and outcome.attempts == 1 + len(watcher.rejections) >= 2
    for violation in watcher.rejections:
        assert violation.check is CheckName.COLLISION and len(violation.agents) == 2
    episode, hit = outcome.episode, watcher.rejections[0]
    assert episode is not None
    parting = next(k for k, plan in enumerate(watcher.plans) if plan.proposal.subgoals[0].verb == "aside")
    assert {subgoal.agent for subgoal in watcher.plans[parting].proposal.subgoals} == set(hit.agents)
    begins, behind_rad = watcher.begins[parting], episode.action[:-1, :, :7] - episode.qpos[1:, :, :7]
    assert begins > hit.time_s * CONTROL_HZ
    for agent in hit.agents:  # let off to where they were measured: what they are told is where they are
        assert np.abs(behind_rad[begins - 1, agent - 1]).max() < 0.02


@pytest.mark.slow
def test_an_arm_that_stands_where_others_will_lift_leaves_before_that_happens():
    """The photographer waits over the camera: without a reason to look, the others lift it into its hand."""
    task = read_task("take_photo")
    with Simulator(task, render=False) as world:
        plans = {}
        for row in (FULL, SPATIAL, BLIND):
            watcher = Watcher()
            outcome = EpisodeGenerator(settings(task, row), world, ScriptedBrain(), watcher).make(2)
            assert outcome.success and outcome.attempts == (2 if row is BLIND else 1)
            plans[row] = watcher.plans[1]  # the first grasps
    for row in (FULL, SPATIAL):
        plan = plans[row]
        positions, waiting = plan.schedule.positions, len(plan.trajectories[3])
        assert waiting > 0 and not plan.proposal.subgoals_of(4)
        if row is SPATIAL:  # in turns
            assert (positions[positions[:, 0] > 0, 3] == waiting).all()
    assert len(plans[BLIND].trajectories[3]) == 0


def test_a_wrong_contact_point_is_caught_before_anything_moves_and_repaired(lift_world):
    watcher, brain = Watcher(), Mistaken(both_left)
    outcome = EpisodeGenerator(settings(lift_world.task), lift_world, brain, watcher).make(0)
    assert outcome.success and outcome.attempts == 2
    (violation,) = watcher.rejections
    assert (violation.check, violation.measured, violation.time_s) == (CheckName.CODE, False, 0.0)
    assert "Agent_2" in violation.sentence
    second = brain.questions[1]
    assert second.feedback == (violation,) and second.scene.step == 0


def test_a_mistake_half_way_is_dated_on_the_clock_of_the_episode(lift_world):
    watcher, brain = Watcher(), Mistaken(lambda proposal: "no json", well=1)
    outcome = EpisodeGenerator(settings(lift_world.task), lift_world, brain, watcher).make(0)
    assert outcome.success and outcome.attempts == 2
    (violation,), began = watcher.rejections, watcher.begins[1]  # the lift, once both have grasped
    assert violation.time_s == began / CONTROL_HZ > 1.0
    assert [question.scene.step for question in brain.questions[:3]] == [0, began, began]


@pytest.mark.slow
@pytest.mark.parametrize(
    "answer", ["no json", '{"Subgoals": {"Agent_9": "home"}}', '{"Subgoals": {"Agent_1": "fly"}}']
)
def test_a_bad_answer_is_feedback_too(lift_world, answer):
    brain = Mistaken(lambda proposal: answer)
    outcome = EpisodeGenerator(settings(lift_world.task), lift_world, brain).make(0)
    assert outcome.success and outcome.attempts == 2
    assert brain.questions[1].feedback[0].check == "RoboBrain"


def test_the_budget_of_attempts_ends_an_episode_with_its_reason(lift_world):
    brain = Mistaken(lambda proposal: "never any json", times=99)
    outcome = EpisodeGenerator(settings(lift_world.task, attempts=3), lift_world, brain).make(0)
    assert not outcome.success and outcome.episode is None
    assert outcome.attempts == 3 == len(brain.questions)
    assert "not the expected JSON" in outcome.reason and outcome.steps == 0


@pytest.mark.slow
def test_arms_take_turns_without_a_model_of_time(lift_world):
    watcher = Watcher()
    EpisodeGenerator(settings(lift_world.task, LOGICAL), lift_world, ScriptedBrain(), watcher).make(0)
    for plan in watcher.plans:
        moves = np.diff(plan.schedule.positions, axis=0)
        assert (moves.sum(axis=1) == 1).all()
    full = Watcher()
    EpisodeGenerator(settings(lift_world.task), lift_world, ScriptedBrain(), full).make(0)
    assert (np.diff(full.plans[1].schedule.positions, axis=0) == 1).all()  # the lift is one motion of both


@pytest.mark.slow
def test_a_heavy_barrier_is_dropped_in_turns_and_lifted_together(lift_barrier):
    """What lost synchronisation costs (paper, section 4.3): one arm alone slips, and the barrier falls."""
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
def test_the_expert_goes_on_from_where_others_have_led(lift_world):
    """Their steps are stored as they were done, and as nobody's subgoal."""
    setting = settings(read_task("lift_barrier"))
    whole = EpisodeGenerator(setting, lift_world, ScriptedBrain()).make(5).episode
    assert whole is not None
    lead = whole.action[:40].astype(float)
    lead[20:, :, 0] += 0.1 * np.linspace(0, 1, 20)[:, None]  # and astray
    known: Any = whole.certificate["subgoals"]
    made = EpisodeGenerator(setting, lift_world, ScriptedBrain()).make(5, lead, known)
    episode = made.episode
    assert made.attempts == 1 and episode is not None and episode.subgoal is not None
    np.testing.assert_array_equal(episode.action[:40], lead.astype(np.float32))
    assert (episode.subgoal[:40] == -1).all() and (episode.subgoal[40:] >= 0).all()
    assert episode.certificate["subgoals"] == known
    moved = np.abs(np.diff(episode.action[39:, :, :7], axis=0)).max(axis=(1, 2))
    assert moved.max() < 1.1 * setting.limits.velocity_rad_s / CONTROL_HZ  # no jump where it takes over


def test_an_error_within_an_episode_names_its_seed_and_keeps_its_class(lift_barrier, monkeypatch):
    def stopped(*_: object) -> None:
        raise StageError("no connection")

    monkeypatch.setattr(ScriptedBrain, "answer", stopped)
    with pytest.raises(StageError, match="seed 7: no connection"):
        make_episode(settings(lift_barrier), NO_PICTURES, 7)


def test_attempts_must_be_positive(lift_barrier):
    with pytest.raises(ArgumentError, match="attempts is 0; at least 1"):
        settings(lift_barrier, attempts=0)


def test_conditions_are_kept_with_their_numbers_whether_they_are_met_or_not(lift_world):
    settings = Settings.configured(lift_world.task, FULL, ScriptedSpec())
    outcome = EpisodeGenerator(settings, lift_world, settings.make_brain(0)).make(0)
    assert outcome.episode is not None
    judged = outcome.episode.judged
    assert judged is not None
    raised = next(k for k, name in enumerate(judged.names) if judged.unit[0, k] == UNITS.index("m"))
    value, bound, holds = judged.value[:, raised], judged.bound[:, raised], judged.holds[:, raised]
    assert not holds[0] and holds[-1]
    assert len(set(bound.tolist())) == 1 and (holds == (value > bound)).all()
    assert len(set(value[~holds].tolist())) > 2  # it rises before it is high enough
