"""Stops keep the joint limits, whatever was going on: on paths, and in repaired episodes of every task."""

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
FAST_RAD_S = 0.3  # of some joint, so that there is something to stop


class Plans(NullObserver):
    def __init__(self):
        self.plans, self.rejections = [], []

    def planned(self, plan):
        self.plans.append(plan)

    def rejected(self, violation):
        self.rejections.append(violation)


class Blinking:
    """A simulator whose sense of touch fails for a moment, once, while somebody carries something fast."""

    def __init__(self, world, blinks=6):
        self._world, self._blinks = world, blinks

    def __getattr__(self, name):
        return getattr(self._world, name)

    def step(self, action):
        scene = self._world.step(action)
        fast = any(
            held is not None and np.abs(qvel[:7]).max() > FAST_RAD_S
            for held, qvel in zip(scene.held, scene.qvel, strict=True)
        )
        if self._blinks and (fast or self._blinks < 6):
            self._blinks -= 1
            return replace(scene, held=(None,) * len(scene.held))
        return scene


def assert_within_limits(commands, limits=LIMITS):
    """Commands (T, N, 7) on the control grid; the first row is where the arms rest before the others."""
    velocity = np.diff(commands, axis=0, prepend=commands[:1]) * CONTROL_HZ
    acceleration = np.diff(velocity, axis=0) * CONTROL_HZ
    assert np.abs(velocity).max() <= 1.001 * limits.velocity_rad_s
    assert np.abs(acceleration).max() <= 1.01 * limits.acceleration_rad_s2


@pytest.fixture(scope="module")
def planned():
    """Commands (T, N, 8) of every plan of an episode in which several arms move at once."""
    task, seen = read_task("three_robots_stack_cube"), Plans()
    with Simulator(task, render=False) as world:
        EpisodeGenerator(
            Settings.configured(task, ConstraintSet("full"), ScriptedSpec()), world, ScriptedBrain(), seen
        ).make(1)
    starts = [np.stack([each.path()[0] for each in plan.trajectories]) for plan in seen.plans]
    return [
        np.concatenate([start[None], scheduled_actions(plan.trajectories, plan.schedule)])
        for start, plan in zip(starts, seen.plans, strict=True)
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
def test_arms_that_stop_stay_on_their_way(planned):
    """All configurations of a stop are of the schedule: what keeps clear there keeps clear here."""
    commands = max(planned, key=len)
    now = len(commands) // 2
    for row in come_to_rest(commands, now, LIMITS)[:, :, :7]:
        ahead = commands[now:, :, :7]
        between = np.linalg.norm(np.diff(ahead, axis=0), axis=(1, 2))
        assert np.linalg.norm(ahead - row, axis=(1, 2)).min() <= between.max()


@pytest.mark.slow
def test_who_stands_still_stops_at_once(planned):
    still = np.tile(planned[0][:1], (10, 1, 1))
    np.testing.assert_array_equal(come_to_rest(still, 5, LIMITS), still[:1])


@pytest.mark.slow
def test_arms_are_let_off_to_where_they_were_measured(planned):
    command = planned[0][0]
    qpos = np.hstack([command[:, :7], np.zeros((3, 2))])
    qpos[1, :7] += 0.2
    rows = relax_to_measured(command, qpos, (2, 3), LIMITS)
    np.testing.assert_allclose(rows[-1, 1, :7], qpos[1, :7])
    np.testing.assert_array_equal(rows[:, [0, 2]], np.tile(command[[0, 2]], (len(rows), 1, 1)))
    assert_within_limits(np.concatenate([command[None], rows])[:, :, :7])
    assert relax_to_measured(command, qpos, (1,), LIMITS).shape == (0, 3, 8)


def made(task, row, seed, world, **disturbed):
    seen = Plans()
    settings = Settings.configured(task, row, ScriptedSpec(), **disturbed)
    return EpisodeGenerator(settings, world, ScriptedBrain(), seen).make(seed), seen


def told(episode):
    """(T + 1, N, 7): where the arms begin, then every command."""
    return np.concatenate([episode.qpos[:1, :, :7], episode.action[:, :, :7]]).astype(float)


def done(episode):
    """(T + 1, N, 7): where the arms begin, then what they were sent to."""
    return np.concatenate([episode.qpos[:1, :, :7], episode.executed[:, :, :7]]).astype(float)


@pytest.mark.slow
def test_a_repaired_episode_keeps_the_joint_limits(task):
    """A law: something seems lost in full motion; all stop, plan again from there, and succeed."""
    with Simulator(task, render=False) as world:
        outcome, seen = made(task, ConstraintSet("full"), 1, Blinking(world))
    assert outcome.violations >= 1 and seen.rejections[0].cause == "grip"
    assert outcome.episode is not None, outcome.reason
    assert_within_limits(told(outcome.episode))


@pytest.mark.slow
@pytest.mark.parametrize("row", [BLINDEST, BLIND], ids=lambda row: row.name)
def test_arms_that_hit_each_other_stop_within_the_limits(row):
    task, hits = read_task("three_robots_stack_cube"), 0
    with Simulator(task, render=False) as world:
        for seed in range(3):
            outcome, seen = made(task, row, seed, world)
            hits += any(violation.cause == "contact" for violation in seen.rejections)
            if outcome.episode is not None:
                assert_within_limits(told(outcome.episode))
    assert hits >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["camera_alignment", "three_robots_stack_cube", "stack_cube"])
def test_what_a_disturbed_arm_means_keeps_the_limits_when_it_stops(name):
    """And what it does is within what those may add to them; it comes to rest where it means to be."""
    more = JointLimits(
        LIMITS.velocity_rad_s + PERTURBATION_LIMITS.velocity_rad_s,
        LIMITS.acceleration_rad_s2 + PERTURBATION_LIMITS.acceleration_rad_s2,
    )
    with Simulator(read_task(name), render=False) as world:
        outcome, seen = made(
            read_task(name), ConstraintSet("full"), 1, Blinking(world), disturbance_rad=0.05, delay_s=1.0
        )
    assert outcome.violations >= 1 and seen.rejections[0].cause == "grip"
    assert outcome.episode is not None, outcome.reason
    assert_within_limits(told(outcome.episode))
    assert_within_limits(done(outcome.episode), more)
    meant, found = told(outcome.episode)[1:], done(outcome.episode)[1:]
    begins = [plan.checked.plan.scene.step for plan in seen.plans[1:]]
    np.testing.assert_array_equal(meant[np.array(begins) - 1], found[np.array(begins) - 1])


@pytest.mark.slow
def test_every_moment_of_a_disturbed_plan_can_be_stopped_within_the_limits(planned):
    """What is meant, whatever is done otherwise at that moment."""
    rng, commands = np.random.default_rng(0), max(planned, key=len)
    waves = np.sin(np.arange(len(commands)) / 4.0)[:, None, None] * rng.normal(0, 0.05, (1, 3, 7))
    executed = commands.copy()
    executed[:, :, :7] += waves
    for now in range(1, len(commands), 7):
        meant, found = come_to_rest_disturbed(commands, executed, now, LIMITS)
        stopped = np.concatenate([commands[: now + 1], meant, meant[-1:]])
        assert_within_limits(stopped[:, :, :7])
        np.testing.assert_allclose(meant[-1], found[-1], atol=1e-9)
        assert meant.shape == found.shape
