"""Stops keep the joint limits at any moment: on planned paths, and in repaired episodes of every task."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.coordination import scheduled_actions
from rf_exp.datagen import EpisodeGenerator, NullObserver, Settings
from rf_exp.datagen.brain import ScriptedBrain, ScriptedSpec
from rf_exp.datagen.disturb import PERTURBATION_LIMITS
from rf_exp.datagen.driving import come_to_rest, come_to_rest_disturbed, relax_to_measured
from rf_exp.sim import Simulator
from rf_exp.tasks import default_of
from rf_exp.types import CONTROL_DT_S, CONTROL_HZ, ConstraintSet, JointLimits
from tests.conftest import read_task

LIMITS = JointLimits(**default_of("limits"))
BLINDEST = ConstraintSet("logical", spatial=False, temporal=False)
BLIND = ConstraintSet("logical_temporal", spatial=False)
FAST_RAD_S = 0.3  # some joint is as fast when the loss is simulated


class PlanRecorder(NullObserver):
    def __init__(self):
        self.plans, self.rejections = [], []

    def planned(self, plan):
        self.plans.append(plan)

    def rejected(self, violation):
        self.rejections.append(violation)


class LossSimulator:
    """Simulator that once, during fast motion with an object, reports no held objects for some steps."""

    def __init__(self, world, lost_steps=6):
        self._world, self._lost_steps = world, lost_steps

    def __getattr__(self, name):
        return getattr(self._world, name)

    def step(self, action):
        scene = self._world.step(action)
        fast = any(
            held is not None and np.abs(qvel[:7]).max() > FAST_RAD_S
            for held, qvel in zip(scene.held, scene.qvel, strict=True)
        )
        if self._lost_steps and (fast or self._lost_steps < 6):
            self._lost_steps -= 1
            return replace(scene, held=(None,) * len(scene.held))
        return scene


def assert_within_limits(commands, limits=LIMITS):
    """Asserts the limits of commands (T, N, 7) on the control grid; in the first row the arms rest."""
    velocity = np.diff(commands, axis=0, prepend=commands[:1]) * CONTROL_HZ
    acceleration = np.diff(velocity, axis=0) * CONTROL_HZ
    assert np.abs(velocity).max() <= 1.001 * limits.velocity_rad_s
    assert np.abs(acceleration).max() <= 1.01 * limits.acceleration_rad_s2


@pytest.fixture(scope="module")
def planned():
    """Commands (T, N, 8) of every plan of an episode in which several arms move at once."""
    task, recorder = read_task("three_robots_stack_cube"), PlanRecorder()
    with Simulator(task, render=False) as world:
        EpisodeGenerator(
            Settings.configured(task, ConstraintSet("full"), ScriptedSpec()), world, ScriptedBrain(), recorder
        ).make(1)
    starts = [np.stack([each.path()[0] for each in plan.trajectories]) for plan in recorder.plans]
    return [
        np.concatenate([start[None], scheduled_actions(plan.trajectories, plan.schedule)])
        for start, plan in zip(starts, recorder.plans, strict=True)
    ]


@pytest.mark.slow
def test_every_moment_of_a_plan_can_be_stopped_within_the_limits(planned):
    longest = 0
    for commands in planned:
        for now in range(1, len(commands), 7):
            rest = come_to_rest(commands, now, LIMITS)
            longest = max(longest, len(rest))
            stopped = np.concatenate([commands[: now + 1], rest, rest[-1:]])
            assert_within_limits(stopped[:, :, :7])
    assert longest * CONTROL_DT_S < 2.5


@pytest.mark.slow
def test_stopping_arms_stay_on_their_paths(planned):
    """All configurations of a stop are on the scheduled path, so the clearances of the schedule hold."""
    commands = max(planned, key=len)
    now = len(commands) // 2
    for row in come_to_rest(commands, now, LIMITS)[:, :, :7]:
        ahead = commands[now:, :, :7]
        between = np.linalg.norm(np.diff(ahead, axis=0), axis=(1, 2))
        assert np.linalg.norm(ahead - row, axis=(1, 2)).min() <= between.max()


@pytest.mark.slow
def test_resting_arms_stop_at_once(planned):
    still = np.tile(planned[0][:1], (10, 1, 1))
    np.testing.assert_array_equal(come_to_rest(still, 5, LIMITS), still[:1])


@pytest.mark.slow
def test_arms_in_contact_relax_to_their_measured_joints(planned):
    command = planned[0][0]
    qpos = np.hstack([command[:, :7], np.zeros((3, 2))])
    qpos[1, :7] += 0.2
    rows = relax_to_measured(command, qpos, (2, 3), LIMITS)
    np.testing.assert_allclose(rows[-1, 1, :7], qpos[1, :7])
    np.testing.assert_array_equal(rows[:, [0, 2]], np.tile(command[[0, 2]], (len(rows), 1, 1)))
    assert_within_limits(np.concatenate([command[None], rows])[:, :, :7])
    assert relax_to_measured(command, qpos, (1,), LIMITS).shape == (0, 3, 8)


def make(task, row, seed, world, **disturbed):
    recorder = PlanRecorder()
    settings = Settings.configured(task, row, ScriptedSpec(), **disturbed)
    return EpisodeGenerator(settings, world, ScriptedBrain(), recorder).make(seed), recorder


def intended_joints(episode):
    """Intended joints (T + 1, N, 7): the initial ones, then every action."""
    return np.concatenate([episode.qpos[:1, :, :7], episode.action[:, :, :7]]).astype(float)


def executed_joints(episode):
    """Executed joints (T + 1, N, 7): the initial ones, then every executed command."""
    return np.concatenate([episode.qpos[:1, :, :7], episode.executed[:, :, :7]]).astype(float)


@pytest.mark.slow
def test_a_repaired_episode_keeps_the_joint_limits(task):
    """For all tasks: an object seems lost in fast motion; all arms stop, replan from there, and succeed."""
    with Simulator(task, render=False) as world:
        outcome, recorder = make(task, ConstraintSet("full"), 1, LossSimulator(world))
    assert outcome.violations >= 1 and recorder.rejections[0].cause == "grip"
    assert outcome.episode is not None, outcome.reason
    assert_within_limits(intended_joints(outcome.episode))


@pytest.mark.slow
@pytest.mark.parametrize("row", [BLINDEST, BLIND], ids=lambda row: row.name)
def test_arms_that_hit_each_other_stop_within_the_limits(row):
    task, hits = read_task("three_robots_stack_cube"), 0
    with Simulator(task, render=False) as world:
        for seed in range(3):
            outcome, recorder = make(task, row, seed, world)
            hits += any(violation.cause == "contact" for violation in recorder.rejections)
            if outcome.episode is not None:
                assert_within_limits(intended_joints(outcome.episode))
    assert hits >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["camera_alignment", "three_robots_stack_cube", "stack_cube"])
def test_intended_commands_of_a_disturbed_arm_keep_the_limits_when_it_stops(name):
    """Executed commands exceed them at most by the limits of perturbations; both come to rest together."""
    sum_limits = JointLimits(
        LIMITS.velocity_rad_s + PERTURBATION_LIMITS.velocity_rad_s,
        LIMITS.acceleration_rad_s2 + PERTURBATION_LIMITS.acceleration_rad_s2,
    )
    with Simulator(read_task(name), render=False) as world:
        outcome, recorder = make(
            read_task(name), ConstraintSet("full"), 1, LossSimulator(world), disturbance_rad=0.05, delay_s=1.0
        )
    assert outcome.violations >= 1 and recorder.rejections[0].cause == "grip"
    assert outcome.episode is not None, outcome.reason
    assert_within_limits(intended_joints(outcome.episode))
    assert_within_limits(executed_joints(outcome.episode), sum_limits)
    intended, executed = intended_joints(outcome.episode)[1:], executed_joints(outcome.episode)[1:]
    starts = [plan.checked.plan.scene.step for plan in recorder.plans[1:]]
    np.testing.assert_array_equal(intended[np.array(starts) - 1], executed[np.array(starts) - 1])


@pytest.mark.slow
def test_every_moment_of_a_disturbed_plan_can_be_stopped_within_the_limits(planned):
    """Intended commands keep the limits, whatever the perturbation at that moment."""
    rng, commands = np.random.default_rng(0), max(planned, key=len)
    waves = np.sin(np.arange(len(commands)) / 4.0)[:, None, None] * rng.normal(0, 0.05, (1, 3, 7))
    executed = commands.copy()
    executed[:, :, :7] += waves
    for now in range(1, len(commands), 7):
        intended, executed_stop = come_to_rest_disturbed(commands, executed, now, LIMITS)
        stopped = np.concatenate([commands[: now + 1], intended, intended[-1:]])
        assert_within_limits(stopped[:, :, :7])
        np.testing.assert_allclose(intended[-1], executed_stop[-1], atol=1e-9)
        assert intended.shape == executed_stop.shape
