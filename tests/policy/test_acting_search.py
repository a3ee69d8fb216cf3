"""Search: after a failed grasp or press, the next attempt goes elsewhere along the ray of the camera."""

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import DiffusionRunner, Policy, PolicyConfig, views
from rf_exp.policy.acting.diffusion_runner import BLOCKED_M, LIFT_M, LIFT_STEPS, NEAR_GOAL_M
from rf_exp.policy.acting.search import MOST_PRESS_SHIFT_M, SAME_PLACE_M, STEPS, Search
from rf_exp.policy.inputs.observation_spec import ObservationSpec
from rf_exp.robots import Arm
from rf_exp.transforms import planar
from tests.policy.conftest import ARCHS, REST, shown, varied
from tests.policy.test_homing import CHANGES, GATED, Elsewhere

BASES = ((0.0, -0.5, 0.0), (0.0, 0.5, np.pi / 2))
RAY = torch.tensor([[0.8, 0.0, -0.6]])  # of a camera that looks down


@pytest.fixture
def runner(policy_config: PolicyConfig) -> DiffusionRunner:
    """Of agent 2, whose fingers close on nothing at the first change of their gripper, as demonstrated."""
    config = varied(policy_config, CHANGES | GATED | {"acting.regrasp_step_m": 0.01})
    view = views(ARCHS[3], 2)[1]
    spec = ObservationSpec(bases=BASES, rests=(tuple(REST),) * 2, keyframes=2, shuts=((), (1,)))
    return DiffusionRunner(Policy(config, view, spec), view, spec)


def test_after_a_failed_grasp_the_goal_is_shifted_along_the_ray(runner: DiffusionRunner) -> None:
    """By STEPS; for another change of its gripper, or another agent, from the beginning."""
    context = torch.zeros(1, 1, runner.spec.size(runner.view))
    context[..., :3] = torch.tensor([0.4, 0.1, 0.05])  # the TCP
    world = Elsewhere(2)
    observation = shown(runner, world.reset(0), world.images())
    rays, directions = runner._rays(observation), runner._directions(observation, context)
    assert rays is not None and directions is not None
    ray = context[0, 0, :3] - rays[0, 0, :, 3]
    torch.testing.assert_close(directions[0, 0], ray / ray.norm())
    search = runner._episode.search
    for failures in range(2 * len(STEPS)):
        assert float(runner._shifts_m()) == pytest.approx(0.01 * STEPS[failures % len(STEPS)])
        search.failed_grasps[2, 0] += 1
    search.failed_grasps[1, 0] += 1
    runner._episode.grippers.changes[1] = 2
    assert float(runner._shifts_m()) == 0


def test_without_a_search_nothing_is_shifted() -> None:
    search = Search(0.0)
    search.failed_grasps[1, 0] += 1
    assert search.shift_m(1, 0) == 0


def test_searching_needs_homing_and_a_goal_gate(policy_config: PolicyConfig) -> None:
    for changes in (CHANGES, GATED | {"context": True}):
        with pytest.raises(ArgumentError, match=r"is 0\.01; expected 0 without acting\.homing and goal_gate"):
            varied(policy_config, changes | {"acting.regrasp_step_m": 0.01})


def test_a_blocked_press_tells_the_height_of_its_goal() -> None:
    """Where the ray has the height of the fingers; the same place is not tried again."""
    search = Search(0.015)
    assert search.press_failed(4, 2, 0.012, 0.6, blocked=True)
    assert search.shift_m(4, 2) == pytest.approx(0.02)
    assert not search.press_failed(4, 2, 0.012 + 0.5 * SAME_PLACE_M * 0.6, 0.6, blocked=True)
    assert search.shift_m(4, 0) == search.shift_m(3, 2) == 0
    assert search.press_failed(4, 2, 1.0, 0.6, blocked=True)
    assert search.shift_m(4, 2) == MOST_PRESS_SHIFT_M


def test_a_level_ray_tells_no_place_for_a_height() -> None:
    search = Search(0.015)
    assert search.press_failed(4, 2, 0.012, 0.0, blocked=True)
    assert search.shift_m(4, 2) == 0.015


def test_a_press_on_nothing_goes_on_farther_along_the_ray() -> None:
    search, found = Search(0.025), []
    while search.press_failed(4, 2, 0.0, 0.6, blocked=False):
        found.append(search.shift_m(4, 2))
    assert found == pytest.approx([0.025, 0.05, MOST_PRESS_SHIFT_M])


def press(runner: DiffusionRunner, deeper_m: float = 0.0, moved_m: float = 0.0, **changes):
    """Targets after two predictions with closed fingers, `deeper_m` above where they are commanded to be.

    The goal is 2 cm above the TCP, or at `offset_m`. Between the predictions the arm moves by `moved_m`.
    """
    offset_m, waiting = changes.get("offset_m", (0.0, 0.0, 0.02)), np.array([changes.get("waits", False)])
    world = Elsewhere(2)
    scene = world.reset(0)
    runner.reset(0)
    runner._episode.homing[:] = False
    runner._episode.grippers.record({2: -1.0}, np.full(2, 0.08))
    runner._episode.openings[:] = changes.get("opening_m", 0.0)
    arm = Arm(runner.spec.robot(2), planar(*BASES[1]))
    pose = arm.tcp(scene.qpos[1])
    commanded = pose.copy()
    commanded[:3, 3] += deeper_m * pose[:3, 2]
    last = arm.postures(commanded, scene.qpos[1, 6]).reshape(-1, 7)
    nearest = np.nanargmin(np.abs(last - scene.qpos[1, :7]).max(axis=1))
    runner.state.targets.start(np.append(last[nearest], [0.0, 0.0])[None])
    found = None
    for beside_m in (moved_m, 0.0):
        world.qpos[1, 0] = scene.qpos[1, 0] + beside_m / np.hypot(*pose[:2, 3] - BASES[1][:2])
        observation = shown(runner, world.scene(), world.images())
        found = runner._next_presses(observation, waiting, torch.tensor([offset_m]), RAY)
    return found, pose, arm


def test_a_failed_press_is_lifted_and_goes_above_the_next_goal(runner: DiffusionRunner) -> None:
    for deeper_m, shift_m in ((0.0, 0.01), (2 * BLOCKED_M, 0.02 / 0.6)):
        targets, pose, arm = press(runner, deeper_m)
        assert targets is not None and len(targets) == sum(LIFT_STEPS)
        assert (targets[:, 0, 7] == -1).all()
        lifted, above = (arm.tcp(targets[row, 0, :7]) for row in (0, -1))
        approach = pose[:3, 2]
        np.testing.assert_allclose(lifted[:3, 3], pose[:3, 3] - LIFT_M * approach, atol=1e-4)
        # The footprint of agent 2 is turned by 90 degrees.
        x, y, z = np.array([0.0, 0.0, 0.02]) + shift_m * RAY[0].numpy()
        expected = pose[:3, 3] + [-y, x, z] - LIFT_M * approach
        np.testing.assert_allclose(above[:3, 3], expected, atol=1e-4)
        np.testing.assert_allclose(above[:3, :3], pose[:3, :3], atol=1e-3)


@pytest.mark.parametrize(
    "changes",
    [
        {"moved_m": 0.01},
        {"waits": True},
        {"offset_m": (0.0, NEAR_GOAL_M, 0.01)},
        {"opening_m": 0.02},
        {"deeper_m": 2 * BLOCKED_M, "offset_m": (0.0, 0.0, 0.001)},
    ],
    ids=("moving", "waiting", "on its way", "holding something", "at the height of its goal"),
)
def test_a_press_that_moves_or_is_where_it_should_be_has_not_failed(runner: DiffusionRunner, changes) -> None:
    assert press(runner, **changes)[0] is None
