"""Homing: arms that start anywhere go to their rest posture before their policies observe."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import DiffusionRunner, Policy, PolicyConfig, rollout, views
from rf_exp.policy.acting.diffusion_runner import SETTLE_STEPS
from rf_exp.policy.inputs.observation_spec import ObservationSpec, spec_of
from rf_exp.policy.networks.heads import DiffusionHead
from rf_exp.robots import DEFAULT, add_robot, registry
from rf_exp.store import Store
from tests.policy.conftest import ARCHS, REST, make_episode, scene_of, shown, varied
from tests.policy.test_rollout import FASTEST_RAD, Table, judge
from tests.robots.toy import toy

AWAY_RAD = np.array([[0.09], [-0.05]])  # offset of all joints of two arms from rest
CHANGES = {"context": True, "observation_steps": 1, "acting.homing": True}
GATED = {"encoder.name": "keypoints", "encoder.keypoints.noise": 0.0, "crop": 1.0, "goal_gate": True}
GATED |= {"relative_actions": True, "task_space_actions": True}


class Elsewhere(Table):
    """World whose arms do not start at rest."""

    def reset(self, seed: int):
        super().reset(seed)
        self.qpos[:, :7] += AWAY_RAD
        return self.scene()


@pytest.fixture
def spec() -> ObservationSpec:
    return ObservationSpec(bases=((0.0, -0.5, 0.0), (0.0, 0.5, 0.0)), rests=(tuple(REST),) * 2)


@pytest.fixture
def make(policy_config: PolicyConfig, spec: ObservationSpec):
    def make(arch, **changes) -> list[DiffusionRunner]:
        config, found = varied(policy_config, CHANGES | changes), []
        for view in views(arch, 2):
            torch.manual_seed(0)
            policy = Policy(config, view, spec)
            policy.normaliser.fastest.fill_(FASTEST_RAD)
            assert isinstance(policy.head, DiffusionHead)
            # Not traced, as in test_rollout.py.
            policy.head.unet.traced = lambda *_: None  # pyright: ignore[reportAttributeAccessIssue]
            found.append(DiffusionRunner(policy, view, spec))
        return found

    return make


@pytest.mark.slow
@pytest.mark.parametrize("arch", (ARCHS[0], ARCHS[3]), ids=lambda arch: arch.name)
def test_arms_are_at_rest_before_the_first_pictures(arch, make) -> None:
    world = Elsewhere(2)
    rollout(world, judge, make(arch), 0, 12)
    path = np.stack([each[:, :7] for each in world.actions])  # (T, 2, 7)
    durations = np.ceil(np.abs(AWAY_RAD[:, 0]) / FASTEST_RAD).astype(int)
    together = len(make(arch)) == 1  # then the arm that is farther away decides
    steps = world.pictures_taken[0]
    assert steps == SETTLE_STEPS + (durations.max() if together else durations.min())
    for agent, (away, duration) in enumerate(zip(AWAY_RAD[:, 0], durations, strict=True)):
        part = np.clip(FASTEST_RAD * np.arange(1, duration + 1) / abs(away), 0, 1)
        np.testing.assert_allclose(path[:duration, agent], REST + away * (1 - part)[:, None], atol=1e-9)
        np.testing.assert_allclose(path[duration : duration + SETTLE_STEPS, agent] - REST, 0, atol=1e-9)
    assert (np.stack(world.actions)[:steps, :, 7] == 1).all()


def test_every_episode_begins_with_homing_and_none_without_the_key(make) -> None:
    world, runners = Elsewhere(2), make(ARCHS[0])
    for seed in (0, 1):
        rollout(world, judge, runners, seed, 10)
        assert world.pictures_taken[0] > SETTLE_STEPS
    rollout(world, judge, make(ARCHS[0], **{"acting.homing": False}), 0, 2)
    assert world.pictures_taken[0] == 0


def test_rest_is_that_of_the_task(make_store, tmp_path: Path, policy_config: PolicyConfig) -> None:
    """It is read from the store of the demonstrations; that of the robot if it is the same, or missing."""
    config, view = varied(policy_config, CHANGES), views(ARCHS[0], 2)[0]
    assert spec_of(config, make_store(2, 3), view).rests == ()
    usual, other = DEFAULT.rest_rad, tuple(REST.tolist())
    for rests, expected in (((usual, usual), ()), ((usual, other), (usual, other))):
        scene: dict[str, Any] = scene_of(2)
        for robot, rest in zip(scene["robots"], rests, strict=True):
            robot["rest_rad"] = list(rest)
        path = tmp_path / f"{len(expected)}.zarr"
        with Store.create(path, {"task": "reach", "scene": scene}, 2, (), 0, 0) as store:
            store.append(replace(make_episode(0, 2), images={}, poses={}))
            spec = spec_of(config, store, view)
        assert spec.rests == expected
        assert [tuple(spec.rest_rad(agent)) for agent in (1, 2)] == [*rests]
        assert ("rests" in spec.identity) == bool(expected)


def test_an_arm_of_six_joints_has_a_rest_of_seven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_ROBOTS", {DEFAULT.name: DEFAULT})
    add_robot(arm := toy(tmp_path))
    rest = ObservationSpec(robots=("panda", "toy")).rest_rad(2)
    assert rest.tolist() == [*arm.rest_rad, 0.0]


def test_homing_needs_context(policy_config: PolicyConfig) -> None:
    with pytest.raises(ArgumentError, match=r"context is False; expected true with acting\.homing"):
        varied(policy_config, {"acting.homing": True})


def test_identities_of_policies_without_homing_lack_the_key(policy_config: PolicyConfig) -> None:
    assert "homing" not in policy_config.identity["acting"] and not policy_config.acting.homing
    assert "acting" not in policy_config.training_values
    with_homing = varied(policy_config, {"context": True, "acting.homing": True})
    assert with_homing.acting_values["acting"]["homing"] is True
    without_homing = varied(policy_config, {"context": True})
    assert with_homing.training_values == without_homing.training_values
    assert (
        with_homing.acting_as(without_homing) == without_homing
        and without_homing.acting_as(with_homing) == with_homing
    )


def gripped(runner: DiffusionRunner, apart_m: float) -> dict[int, np.ndarray]:
    """Predictions of a runner with targets left, after agent 1 has closed its fingers to `apart_m`."""
    world = Elsewhere(2)
    scene = world.reset(0)
    world.qpos[0, 7:] = apart_m / 2
    runner.reset(0)
    runner._episode.homing[:] = False
    runner._episode.grippers.record({1: -1.0}, np.full(2, 0.08))
    runner.state.targets.start(scene.qpos[[agent - 1 for agent in runner.view.agents]])
    runner.state.targets.put(np.zeros((5, len(runner.view.agents), 8)))
    runner(shown(runner, world.scene(), world.images()))
    return dict(runner.state.predicted)


def test_after_a_failed_grasp_an_agent_goes_to_rest_and_observes_again(make) -> None:
    (runner,) = (each for each in make(ARCHS[3]) if each.view.agents == (1,))
    chunk = gripped(runner, 0.001)[1]
    assert np.allclose(chunk, np.append(REST, 1.0))
    assert not runner._episode.homing.any()
    assert gripped(runner, 0.02) == {}  # it holds something, and has targets left


def test_after_a_failed_grasp_other_agents_wait_as_they_are(make) -> None:
    (runner,) = make(ARCHS[0])
    found = gripped(runner, 0.001)
    assert np.allclose(found[1], np.append(REST, 1.0))
    assert np.allclose(found[2], np.append(REST + AWAY_RAD[1], 1.0))
    assert len(found[1]) == len(found[2])


def test_fingers_that_are_meant_to_close_fully_are_no_failed_grasp(make, spec: ObservationSpec) -> None:
    (runner,) = (each for each in make(ARCHS[3]) if each.view.agents == (1,))
    runner.spec = replace(spec, shuts=((1,), ()))
    assert gripped(runner, 0.001) == {}
    runner.spec = replace(spec, shuts=((2,), (1,)))
    assert gripped(runner, 0.001) != {}


def test_a_failed_grasp_counts_for_its_gripper_change(make) -> None:
    (runner,) = (each for each in make(ARCHS[3]) if each.view.agents == (1,))
    gripped(runner, 0.02)
    assert not runner._episode.search.failed_grasps
    gripped(runner, 0.001)
    assert runner._episode.search.failed_grasps == {(1, 0): 1}


@pytest.mark.parametrize(("width_m", "expected"), [(0.001, ((1,), ())), (0.02, ())])
def test_demonstrations_show_when_fingers_are_meant_to_close_fully(
    tmp_path: Path, policy_config: PolicyConfig, width_m: float, expected
) -> None:
    """In most of them: one with a failed grasp at first does not count."""
    path, view = tmp_path / "pressed.zarr", views(ARCHS[0], 2)[0]
    with Store.create(path, {"task": "reach", "scene": scene_of(2)}, 2, (), 0, 0) as store:
        for seed in range(3):
            episode = replace(make_episode(seed, 2), images={}, poses={})
            closed = episode.action[:, 0, 7] < 0
            episode.qpos[closed, 0, 7:] = width_m / 2
            if seed == 0:
                episode.qpos[closed, 1, 7:] = 0.0
            store.append(episode)
        assert spec_of(varied(policy_config, CHANGES), store, view).shuts == expected
