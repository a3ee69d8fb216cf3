"""Homing: arms that start anywhere go to their posture of rest before they look."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import DiffusionRunner, Policy, PolicyConfig, rollout, views
from rf_exp.policy.acting.diffusion_runner import SETTLE_STEPS
from rf_exp.policy.inputs.observation_spec import ObservationSpec, spec_of
from rf_exp.robots import DEFAULT, add_robot, known
from rf_exp.store import Store
from tests.policy.conftest import ARCHS, REST, make_episode, scene_of, varied
from tests.policy.test_rollout import FASTEST_RAD, Table, judge
from tests.robots.toy import toy

AWAY_RAD = np.array([[0.09], [-0.05]])  # of all joints of two arms, from rest
CHANGES = {"context": True, "observation_steps": 1, "acting.homing": True}


class Elsewhere(Table):
    """Its arms start elsewhere."""

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
            policy.head.unet.quick = lambda *_: None  # as in test_rollout.py
            found.append(DiffusionRunner(policy, view, spec))
        return found

    return make


@pytest.mark.slow
@pytest.mark.parametrize("arch", (ARCHS[0], ARCHS[3]), ids=lambda arch: arch.name)
def test_arms_are_at_rest_before_they_look(arch, make) -> None:
    world = Elsewhere(2)
    rollout(world, judge, make(arch), 0, 12)
    path = np.stack([each[:, :7] for each in world.actions])  # (T, 2, 7)
    goes = np.ceil(np.abs(AWAY_RAD[:, 0]) / FASTEST_RAD).astype(int)
    together = len(make(arch)) == 1  # then it takes as long as for the arm that is farther away
    steps = world.pictures_taken[0]
    assert steps == SETTLE_STEPS + (goes.max() if together else goes.min())
    for agent, (away, needs) in enumerate(zip(AWAY_RAD[:, 0], goes, strict=True)):
        part = np.clip(FASTEST_RAD * np.arange(1, needs + 1) / abs(away), 0, 1)
        np.testing.assert_allclose(path[:needs, agent], REST + away * (1 - part)[:, None], atol=1e-9)
        np.testing.assert_allclose(path[needs : needs + SETTLE_STEPS, agent] - REST, 0, atol=1e-9)
    assert (np.stack(world.actions)[:steps, :, 7] == 1).all()


def test_every_episode_begins_so_and_none_without_the_key(make) -> None:
    world, runners = Elsewhere(2), make(ARCHS[0])
    for seed in (0, 1):
        rollout(world, judge, runners, seed, 10)
        assert world.pictures_taken[0] > SETTLE_STEPS
    rollout(world, judge, make(ARCHS[0], **{"acting.homing": False}), 0, 2)
    assert world.pictures_taken[0] == 0


def test_rest_is_that_of_the_task(make_store, tmp_path: Path, policy_config: PolicyConfig) -> None:
    """Which the store of its demonstrations tells, and that of the robot where it is the same, or is not told."""
    config, view = varied(policy_config, CHANGES), views(ARCHS[0], 2)[0]
    assert spec_of(config, make_store(2, 3), view).rests == ()
    usual, other = DEFAULT.rest_rad, tuple(REST.tolist())
    for rests, expected in (((usual, usual), ()), ((usual, other), (usual, other))):
        scene = scene_of(2)
        scene["robots"] = [
            {**each, "rest_rad": list(rest)} for each, rest in zip(scene["robots"], rests, strict=True)
        ]
        path = tmp_path / f"{len(expected)}.zarr"
        with Store.create(path, {"task": "reach", "scene": scene}, 2, (), 0, 0) as store:
            store.append(replace(make_episode(0, 2), images={}, poses={}))
            spec = spec_of(config, store, view)
        assert spec.rests == expected
        assert [tuple(spec.rest_rad(agent)) for agent in (1, 2)] == [*rests]
        assert ("rests" in spec.identity) == bool(expected)


def test_an_arm_of_six_joints_has_a_rest_of_seven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known, "_KNOWN", {DEFAULT.name: DEFAULT})
    add_robot(arm := toy(tmp_path))
    rest = ObservationSpec(robots=("panda", "toy")).rest_rad(2)
    assert rest.tolist() == [*arm.rest_rad, 0.0]


def test_where_arms_rest_has_to_be_told(policy_config: PolicyConfig) -> None:
    with pytest.raises(ArgumentError, match=r"context is False; expected true with acting\.homing"):
        varied(policy_config, {"acting.homing": True})


def test_policies_that_do_not_home_say_nothing_of_it(policy_config: PolicyConfig) -> None:
    assert "homing" not in policy_config.identity["acting"] and not policy_config.acting.homing
    assert "acting" not in policy_config.learned
    homes = varied(policy_config, {"context": True, "acting.homing": True})
    assert homes.acted["acting"]["homing"] is True
    assert homes.learned == varied(policy_config, {"context": True}).learned
