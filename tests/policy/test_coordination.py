"""Subgoals and permission to go on as inputs of policies, from demonstrations and in rollouts."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy import (
    DiffusionRunner,
    Policy,
    PolicyConfig,
    TrainConfig,
    Windows,
    load_runners,
    rollout,
    train,
    views,
)
from rf_exp.policy.acting.diffusion_runner import WAIT_STEPS
from rf_exp.policy.inputs.coordination import (
    GRIPPING_STEPS,
    held_up_mask,
    may_go_on_mask,
    numbered_subgoals,
    phase_vectors,
)
from rf_exp.policy.inputs.observation_spec import spec_of
from rf_exp.store import Store
from rf_exp.types import Arch, Scene
from tests.policy.conftest import ARCHS, REST, STEPS, varied
from tests.policy.test_rollout import Table, judge

COORDINATED = Arch("separate_coordinated", False, False, True)
PREDICTING = {  # policies that predict their subgoals themselves
    **{"phases": True, "head.name": "refined", "head.regression.hidden": (16,)},
    **{"head.refined.regression_steps": 4, "acting.action_steps": 8, "horizon": 8, "observation_steps": 1},
}


@pytest.fixture
def with_context(policy_config: PolicyConfig) -> PolicyConfig:
    return varied(policy_config, {"context": True})


def test_agents_may_go_on_from_their_first_motion_until_they_are_done() -> None:
    """Agent 1 moves, grips and is done; agent 2 waits until it may move, and moves to the end."""
    action = np.tile(np.append(REST, 1.0), (60, 2, 1))
    action[:20, 0, 0] += np.arange(20) / 10
    action[20:, 0, 0] = action[19, 0, 0]
    action[20:, 0, 7] = -1.0
    action[40:, 1, 0] += np.arange(1, 21) / 10
    qpos = np.concatenate([action[..., :7], np.zeros((60, 2, 2))], axis=2)
    free = may_go_on_mask(qpos, action, action)
    assert np.array_equal(np.flatnonzero(~free[:, 0]), np.arange(20 + GRIPPING_STEPS, 60))
    assert np.array_equal(np.flatnonzero(~free[:, 1]), np.arange(40))


def test_nobody_waits_where_all_hold_still() -> None:
    """All hold still until the end, or pause too briefly for a wait."""
    action = np.tile(np.append(REST, 1.0), (30, 1, 1))
    action[:10, 0, 0] += np.repeat(np.arange(5), 2) / 10
    assert may_go_on_mask(
        np.concatenate([action[..., :7], np.zeros((30, 1, 2))], axis=2), action, action
    ).all()


@pytest.mark.parametrize("stands", [True, False], ids=["now", "until generator 5"])
def test_an_agent_that_is_held_up_may_go_on(stands: bool) -> None:
    """Agent 1 is held up at steps 10 to 14, where agent 2 waits as intended.

    With `stands`, the intended command of agent 1 in the last of these steps is its present position.
    """
    path = np.tile(np.append(REST, 1.0), (40, 1))
    path[:, 0] += np.arange(40) / 10
    at = np.concatenate([np.arange(1, 11), np.full(5, 10), np.arange(11, 26)])
    executed = np.stack([path[at]] * 2, axis=1)
    action = executed.copy()
    action[10 : 14 if stands else 15, 0] = path[11]
    held_up = held_up_mask(action, executed)
    assert np.flatnonzero(held_up[:, 0]).tolist() == list(range(10, 15)) and not held_up[:, 1].any()
    assert not held_up_mask(executed, executed).any()
    qpos = np.concatenate([executed[..., :7], np.zeros((30, 2, 2))], axis=2)
    free = may_go_on_mask(qpos, action, executed)
    assert free[:, 0].all() and np.flatnonzero(~free[:, 1]).tolist() == list(range(10, 15))


def test_subgoals_beyond_those_in_training_count_as_the_last() -> None:
    found = phase_vectors(np.array([0, 2, 7]), np.array([True, False, True]), 3)
    assert found.tolist() == [[1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 1, 1]]


def test_the_context_has_the_subgoals_of_the_own_agent(make_store, with_context: PolicyConfig) -> None:
    store: Store = make_store(2, 3)
    assert numbered_subgoals(store)[0].max() + 1 == 2
    for agent, view in enumerate(views(COORDINATED, 2), start=1):
        windows, spec = (
            Windows(store, view, with_context, torch.device("cpu")),
            spec_of(with_context, store, view),
        )
        assert windows.context.shape == (store.steps, spec.size(view))
        numbers = windows.context[:, -3:-1].argmax(dim=1).numpy()
        assert np.array_equal(numbers, store.subgoal[:, agent - 1])


def test_a_number_means_the_same_subgoal_in_every_episode(make_store) -> None:
    """If an arm moves aside in some episodes, or tries again, later subgoals keep their numbers."""
    subgoals = (
        [["grasp a at left", "lift a by 0.1 m"], ["press b at top"]],
        [["grasp a at left", "lift a by 0.2 m"], ["press b at top"]],
        [["grasp a at left", "lift a by 0.1 m"], ["aside", "press b at top"]],
        [["aside", "lift a by 0.1 m"], ["hold", "press b at top"]],
    )
    store: Store = make_store(2, 4)
    subgoal, ends = store.subgoal[:], [0, *store.episode_ends]
    for episode, texts in enumerate(subgoals):
        rows = slice(ends[episode], ends[episode + 1])
        subgoal[rows, 0] = 1
        subgoal[rows, 1] = len(texts[1]) - 1  # to press
    subgoal[: ends[1] // 2] = -1  # steps of a policy

    class StubStore:
        path = store.path
        subgoal: NDArray
        certificates: list[dict]
        by_episode = store.by_episode

    StubStore.subgoal, StubStore.certificates = subgoal, [{"subgoals": texts} for texts in subgoals]
    numbers, names = numbered_subgoals(StubStore)  # pyright: ignore[reportArgumentType]
    assert names == (("grasp a at left", "lift a", "aside"), ("press b at top", "aside", "hold"))
    assert (numbers[ends[1] // 2 :] == (1, 0)).all() and (numbers[: ends[1] // 2] == -1).all()
    StubStore.certificates = [{"subgoals": subgoals[0]}] * 4
    StubStore.subgoal = np.minimum(subgoal, (1, 0))
    assert numbered_subgoals(StubStore)[1] == ()  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_policies_receive_the_subgoals_of_the_coordinator(
    make_store, with_context: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    for view in views(COORDINATED, 2):
        train(make_store(2, 3), view, with_context, train_config, tmp_path / view.name)
    grippers: list[dict[int, float]] = []

    def coordinate(_: Scene, last: Mapping[int, float]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        grippers.append({**last})
        return np.array([number, 0]), np.array([True, True])

    def acted() -> NDArray[np.float64]:
        world = Table(2)
        rollout(world, judge, load_runners(tmp_path), 1, 8, coordinate=coordinate)
        return np.stack(world.actions)

    number = 0
    first = acted()
    number = 1
    second = acted()
    assert grippers[0] == {1: 1.0, 2: 1.0} and len(grippers) == 16
    assert [*grippers[1].values()] == first[0, :, 7].tolist()
    assert np.abs(first[:, 0] - second[:, 0]).max() > 1e-6  # agent 1 received another subgoal
    assert np.array_equal(first[0, 1], second[0, 1])  # agent 2 did not
    with pytest.raises(StageError, match="policy 'agent1' was trained with a coordinator; none is running"):
        rollout(Table(2), judge, load_runners(tmp_path), 1, 8)


def test_missing_requirements_are_named(make_store, policy_config: PolicyConfig) -> None:
    (view, _) = views(COORDINATED, 2)
    with pytest.raises(ArgumentError, match="a coordinated architecture needs policy"):
        spec_of(policy_config, make_store(2, 3), view)
    with pytest.raises(ArgumentError, match="context is False; expected true with phases"):
        varied(policy_config, {"phases": True})


@pytest.mark.slow
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_a_policy_predicts_subgoals_and_who_may_go_on(
    arch: Arch, make_store, with_context: PolicyConfig, train_config: TrainConfig, tmp_path: Path, monkeypatch
) -> None:
    """They end the context, per own agent. One that may not go on holds still and soon predicts again."""
    store: Store = make_store(2, 3)
    config = varied(with_context, PREDICTING)
    for view in views(arch, 2):
        train(store, view, config, train_config, tmp_path / view.name)
        windows = Windows(store, view, config, torch.device("cpu"))
        for row, stream in enumerate(view.streams):
            phases = windows.context[row * store.steps : (row + 1) * store.steps, -3 * len(stream.agents) :]
            for column, agent in enumerate(stream.agents):
                numbers = phases[:, 3 * column : 3 * column + 2].argmax(dim=1).numpy()
                assert np.array_equal(numbers, store.subgoal[:, agent - 1])
    runners = load_runners(tmp_path)
    predictions: list[bool] = []

    def stay(runner: DiffusionRunner, context: torch.Tensor, numbers: torch.Tensor, free: torch.Tensor):
        found = Policy.with_phases(runner._policy, context, numbers, free)
        own = 3 * len(runner.view.streams[0].agents)
        assert found.shape == context.shape and torch.equal(found[..., :-own], context[..., :-own])
        phase = found[..., -own:].unflatten(-1, (-1, 3))
        assert torch.equal(phase[:, 0, :, :2].argmax(dim=-1), numbers)
        assert torch.equal(phase[:, 0, :, 2] > 0, free) and not free.any()
        predictions.append(True)
        return found

    def nobody_goes(runner: DiffusionRunner, *observed: torch.Tensor):
        probabilities = Policy.transition_probabilities(runner._policy, *observed)
        assert probabilities is not None and torch.allclose(probabilities[..., :-1].sum(dim=2), torch.ones(1))
        return torch.cat([probabilities[..., :-1], torch.zeros_like(probabilities[..., -1:])], dim=2)

    for runner in runners:
        monkeypatch.setattr(runner._policy, "with_phases", partial(stay, runner))
        monkeypatch.setattr(runner._policy, "transition_probabilities", partial(nobody_goes, runner))
    world = Table(2)
    start = world.reset(1).qpos[:, :7]
    rollout(world, judge, runners, 1, 2 * WAIT_STEPS)
    assert np.array_equal(np.stack(world.actions)[..., :7], np.tile(start, (2 * WAIT_STEPS, 1, 1)))
    assert (np.stack(world.actions)[..., 7] == 1.0).all()
    assert len(predictions) == 2 * len(runners)


@pytest.mark.slow
def test_a_waiting_agent_does_not_shorten_the_chunk_of_another(
    make_store, with_context: PolicyConfig, train_config: TrainConfig, tmp_path: Path, monkeypatch
) -> None:
    """One policy for both: a gripper that opens at the end of its chunk would otherwise never open."""
    config = varied(with_context, PREDICTING)
    (view, *_) = views(ARCHS[0], 2)
    train(make_store(2, 3), view, config, train_config, tmp_path / view.name)
    (runner,) = load_runners(tmp_path)
    assert isinstance(runner, DiffusionRunner) and config.acting.action_steps > WAIT_STEPS
    policy, predictions = runner._policy, []

    def the_first_goes(*observed: torch.Tensor) -> torch.Tensor | None:
        predictions.append(True)
        probabilities = Policy.transition_probabilities(policy, *observed)
        assert probabilities is not None
        return torch.cat([probabilities[..., :-1], torch.tensor([[[1.0], [0.0]]])], dim=2)

    targets = torch.zeros(1, config.horizon, 2, 8)
    targets[..., 7] = -1.0  # closed until the last of its steps
    targets[:, -1, 0, 7] = 1.0
    monkeypatch.setattr(policy, "transition_probabilities", the_first_goes)
    monkeypatch.setattr(policy, "act", lambda *_: targets.flatten(2))
    world = Table(2)
    rollout(world, judge, [runner], 1, config.acting.action_steps)
    executed = np.stack(world.actions)
    assert len(predictions) == 1
    assert executed[:, 0, 7].tolist() == [-1.0] * (config.acting.action_steps - 1) + [1.0]
    assert (executed[:, 1, 7] == 1.0).all() and not np.ptp(executed[:, 1, :7], axis=0).any()


def test_chunks_smaller_than_the_deadband_are_not_executed(
    make_store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path, monkeypatch
) -> None:
    config = varied(policy_config, {"context": True, "acting.deadband_rad": 0.03})
    (view, *_) = views(ARCHS[0], 2)  # one policy for both
    train(make_store(2, 3), view, config, train_config, tmp_path / view.name)
    (runner,) = load_runners(tmp_path)
    world = Table(2)
    start = world.reset(1)
    targets = np.tile(np.append(np.zeros(7), 1.0), (1, 8, 2))
    targets[..., :7] = start.qpos[0, :7] + 0.02  # agent 1 stays within the bound, agent 2 ends outside
    targets[..., 8:15] = start.qpos[1, :7] + np.linspace(0, 0.04, 8)[:, None]
    monkeypatch.setattr(runner._policy, "act", lambda *_: torch.from_numpy(targets))
    rollout(world, judge, [runner], 1, 3)
    moved = np.abs(np.stack(world.actions)[..., :7] - start.qpos[:, :7]).max(axis=(0, 2))
    assert moved[0] == 0 and moved[1] > 0


def test_a_store_without_subgoals_is_refused(make_store, with_context: PolicyConfig, monkeypatch) -> None:
    store: Store = make_store(2, 3)
    monkeypatch.setitem(store._cache, "subgoal", np.full((3 * STEPS, 2), -1, np.int16))
    with pytest.raises(ArgumentError, match="does not record the subgoals of its agents; generate it again"):
        spec_of(with_context, store, views(COORDINATED, 2)[0])
