"""Windows: padding at the ends, every window once, every frame once, clear errors."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.policy import PolicyConfig, Stream, View, Windows, views
from rf_exp.policy.examples.windows import action_origin
from rf_exp.policy.inputs.observation_spec import MOST_CHANGES, POSE_SIZE, proprioception
from rf_exp.policy.inputs.pictures import crop
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.policy.networks.policy import Range
from rf_exp.store import Store
from rf_exp.types import Arch
from tests.policy.conftest import ARCHS, HEIGHT, STEPS, STILL, WIDTH, make_episode, scene_of, varied

CPU = torch.device("cpu")
LOCAL = View("agent1", (Stream("agent1", (1,)),))


@pytest.fixture
def store(make_store: Callable[[int, int], Store]) -> Store:
    return make_store(2, 3)


def test_windows_repeat_the_ends_of_their_episode(store: Store, policy_config: PolicyConfig) -> None:
    windows = Windows(store, LOCAL, policy_config, CPU)
    first, last = STEPS, 2 * STEPS - 1  # of the second episode
    batch = windows.batch(np.array([first, first + 1, last]), None)
    proprio = proprioception(store.qpos[:, :1])
    action = store.action[:, 0]
    seen = [[first, first, first], [first, first, first + 1], [last - 2, last - 1, last]]
    assert np.array_equal(batch.proprio.numpy(), proprio[np.array(seen)])
    done = [
        [first, first, first, *range(first + 1, first + 6)],
        [first, *range(first, first + 7)],
        [last - 2, last - 1, *[last] * 6],
    ]
    assert np.array_equal(batch.action.numpy(), action[np.array(done)])


def test_the_action_executed_first_is_the_one_of_the_newest_frame(
    store: Store, policy_config: PolicyConfig
) -> None:
    windows = Windows(store, LOCAL, policy_config, CPU)
    batch = windows.batch(np.array([10]), None)
    assert np.array_equal(batch.action[0, policy_config.observation_steps - 1], store.action[10, 0])


@pytest.mark.slow
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_steps_of_an_agent_that_is_held_up_have_the_targets_after_the_pause(
    arch: Arch, policy_config: PolicyConfig, tmp_path: Path
) -> None:
    """Agent 2 is held up for 4 steps at its 9th: its targets there are those after the pause."""
    made = make_episode(0, 2)
    assert STILL < 8
    pauses = np.r_[np.arange(9), np.full(4, 8), np.arange(9, STEPS)]  # its step of the plan
    padded = np.r_[np.arange(STEPS), np.full(4, STEPS - 1)]  # of agent 1, which finishes earlier

    def delayed(values: NDArray) -> NDArray:
        return np.stack([values[padded, 0], values[pauses, 1]], axis=1)

    assert made.subgoal is not None
    intended, executed = delayed(made.action), delayed(made.action)
    intended[9:12, 1] = made.action[9, 1]  # in the last step of the pause, the present position
    episode = replace(
        made,
        qpos=delayed(made.qpos),
        qvel=delayed(made.qvel),
        action=intended,
        executed=executed,
        images={name: frames[padded] for name, frames in made.images.items()},
        poses={name: values[padded] for name, values in made.poses.items()},
        subgoal=delayed(made.subgoal[..., None])[..., 0],
    )
    identity = {"task": "reach", "scene": scene_of(2)}
    cameras = tuple(made.images)
    path = tmp_path / "late.zarr"
    with Store.create(path, identity, 2, cameras, HEIGHT, WIDTH, tuple(made.poses), True) as store:
        store.append(episode)
    changes = {"context": True, "task_space_actions": True, "observation_steps": 1}
    config = varied(policy_config, changes)
    for view in views(arch, 2):
        windows = Windows(Store.open(path), view, config, CPU)
        for row, stream in enumerate(view.streams):
            batch = windows.batch(row * (STEPS + 4) + np.array([10, 13]), None).action
            for column, agent in enumerate(stream.agents):
                joints = batch[..., column * ACTION_SIZE : (column + 1) * ACTION_SIZE]
                steps = np.arange(policy_config.horizon)
                plan = np.stack([13 + steps] * 2 if agent == 2 else [10 + steps, 13 + steps])
                assert np.array_equal(joints, executed[np.minimum(plan, STEPS + 3), agent - 1])


def test_steps_of_others_are_not_learned(policy_config: PolicyConfig, tmp_path: Path) -> None:
    """Steps before the expert took over give no window and no keypoint; the gripper history counts them."""
    lead, made = 8, make_episode(0, 1)
    assert made.subgoal is not None
    led = replace(made, seed=1, subgoal=np.where(np.arange(STEPS)[:, None] < lead, -1, made.subgoal))
    led.action[:lead, 0, 7] = np.where(np.arange(lead) < 4, -1, 1)  # the fingers held something and let go
    identity = {"task": "reach", "scene": scene_of(1)}
    path = tmp_path / "led.zarr"
    with Store.create(path, identity, 1, tuple(made.images), HEIGHT, WIDTH, tuple(made.poses)) as store:
        for episode in (make_episode(0, 1), led):
            store.append(episode)
    windows = Windows(Store.open(path), LOCAL, varied(policy_config, {"context": True}), CPU)
    assert len(windows) == 2 * STEPS - lead
    assert np.array_equal(windows.action[STEPS:, :8], led.action[lead:, 0])
    changes = windows.context[:, POSE_SIZE : POSE_SIZE + MOST_CHANGES + 1].argmax(dim=1)
    assert changes[0] == 0 and changes[STEPS] == 2


def test_pictures_of_a_batch_are_correct_and_without_duplicates(
    store: Store, policy_config: PolicyConfig
) -> None:
    windows = Windows(store, LOCAL, policy_config, CPU)
    chosen = np.array([5, 6, 7, 8, STEPS, STEPS + 1])
    batch = windows.batch(chosen, None)
    assert len(batch.pictures) == 6 + 2  # frames 3..8 and the second episode's 0, 1
    height, width = policy_config.cropped(HEIGHT, WIDTH)
    top, left = (HEIGHT - height) // 2, (WIDTH - width) // 2
    stored = np.asarray(store.images["agent1"][:])[:, top : top + height, left : left + width]
    frames = [[3, 4, 5], [4, 5, 6], [5, 6, 7], [6, 7, 8], [STEPS] * 3, [STEPS, STEPS, STEPS + 1]]
    assert np.array_equal(batch.pictures[batch.frames].numpy(), stored[np.array(frames)])


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_an_epoch_has_every_window_once(arch, store: Store, policy_config: PolicyConfig) -> None:
    for view in views(arch, 2):
        windows = Windows(store, view, policy_config, CPU)
        assert len(windows) == len(view.streams) * 3 * STEPS
        batches = windows.epoch(16, 4, np.random.default_rng(0))
        assert len(batches) == windows.batches(16)
        assert max(map(len, batches)) - min(map(len, batches)) <= 1
        assert sorted(np.concatenate(batches).tolist()) == list(range(len(windows)))
        batch = windows.batch(batches[0], None)
        assert batch.action.shape == (len(batches[0]), policy_config.horizon, view.action_size)
        assert batch.proprio.shape[1:] == (policy_config.observation_steps, view.proprio_size)


def test_streams_of_a_shared_policy_do_not_mix(store: Store, policy_config: PolicyConfig) -> None:
    shared = views(ARCHS[1], 2)[0]
    windows = Windows(store, shared, policy_config, CPU)
    for agent in (1, 2):
        alone = View("alone", (Stream(f"agent{agent}", (agent,)),))
        expected = Windows(store, alone, policy_config, CPU).batch(np.arange(4), None)
        found = windows.batch(np.arange(4) + (agent - 1) * 3 * STEPS, None)
        for name in ("pictures", "frames", "proprio", "action"):
            assert torch.equal(getattr(found, name), getattr(expected, name)), name


def test_frames_of_a_run_share_a_crop_and_runs_differ(store: Store, policy_config: PolicyConfig) -> None:
    config = varied(policy_config, {"crop": 0.5})
    windows = Windows(store, LOCAL, config, CPU)
    runs = np.concatenate([np.arange(start, start + 4) for start in range(0, 2 * STEPS, 6)])
    batch = windows.batch(runs, np.random.default_rng(0))
    of_run = batch.pictures[batch.frames].reshape(len(runs) // 4, 12, -1)
    assert all((run == run[0]).all() for run in of_run)  # pictures do not change within an episode
    assert len({run[0].numpy().tobytes() for run in of_run[:4]}) > 1


def test_crops_are_the_slices() -> None:
    pictures = torch.arange(4 * 6 * 7 * 3, dtype=torch.int32).reshape(4, 6, 7, 3).to(torch.uint8)
    frames, corners = np.array([1, 2, 2, 0]), np.array([[0, 1], [0, 1], [2, 3], [1, 0]])
    found = crop(pictures, frames, corners, (4, 4))
    for piece, frame, (top, left) in zip(found, frames, corners, strict=True):
        assert torch.equal(piece, pictures[frame, top : top + 4, left : left + 4])


def test_proprioception_is_seven_joints_and_the_opening() -> None:
    qpos = np.arange(18, dtype=float).reshape(1, 2, 9)
    assert proprioception(qpos).tolist() == [[*range(7), 15.0, *range(9, 16), 33.0]]


def test_a_missing_camera_is_reported_with_the_available_ones(
    store: Store, policy_config: PolicyConfig
) -> None:
    view = View("agent7", (Stream("agent7", (1,)),))
    with pytest.raises(
        ArgumentError, match="needs camera 'agent7', but the store has global, agent1, agent2"
    ):
        Windows(store, view, policy_config, CPU)


def test_pictures_of_another_size(store: Store, policy_config: PolicyConfig) -> None:
    with pytest.raises(ArgumentError, match="are 32 x 48 pixels; the policy expects 32 x 64"):
        Windows(store, LOCAL, varied(policy_config, {"width": 64}), CPU)


def test_a_store_without_episodes(tmp_path, policy_config: PolicyConfig) -> None:
    store = Store.create(tmp_path / "s.zarr", {"task": "reach"}, 1, ("agent1",), HEIGHT, WIDTH)
    with pytest.raises(ArgumentError, match="the store holds no episode; expected at least one"):
        Windows(store, LOCAL, policy_config, CPU)


def test_relative_actions_start_at_the_newest_joints_except_for_grippers() -> None:
    proprio = torch.arange(32, dtype=torch.float32).reshape(1, 2, 16)  # (B, O, 8N)
    assert action_origin(proprio).tolist() == [[[*range(16, 23), 0, *range(24, 31), 0]]]


def range_of(windows: Windows) -> Range:
    """Range of the actions, as a policy normalises them."""
    found = Range(windows.action.shape[1])
    found.fit(windows.learned_actions())
    return found


def test_the_range_of_relative_actions_is_that_of_all_windows(
    store: Store, policy_config: PolicyConfig
) -> None:
    windows = Windows(store, LOCAL, varied(policy_config, {"relative_actions": True}), CPU)
    batch = windows.batch(np.arange(len(windows)), None)
    found = range_of(windows).normalise(batch.action - action_origin(batch.proprio))
    assert found.amin() == pytest.approx(-1.0, abs=1e-5)
    assert found.amax() == pytest.approx(1.0, abs=1e-5)
    absolute = Windows(store, LOCAL, varied(policy_config, {"relative_actions": False}), CPU)
    assert range_of(absolute).normalise(batch.action).amax() == pytest.approx(1.0, abs=1e-5)
