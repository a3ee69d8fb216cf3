"""Context features: the same from a store and in a rollout, their frames and scales, what they need."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import (
    DiffusionRunner,
    Policy,
    PolicyConfig,
    Stream,
    View,
    Windows,
    load_policy,
    train,
    views,
)
from rf_exp.policy.inputs.observation_spec import (
    HISTORY_SIZE,
    POSE_SIZE,
    GripperHistory,
    ObservationSpec,
    clipped_offsets,
    context,
    spec_of,
    tcp_poses,
)
from rf_exp.store import Store
from rf_exp.transforms import from_quaternion, planar, quaternion
from tests.policy.conftest import ARCHS, STEPS, make_episode, scene_at, shown, small_training, varied

CPU = torch.device("cpu")
OPEN_M = 0.08
LOCAL = View("agent1", (Stream("agent1", (1,)),))


@pytest.fixture
def privileged(policy_config: PolicyConfig) -> PolicyConfig:
    """A privileged-state policy."""
    return varied(policy_config, {"encoder.name": "privileged", "context": True, "observation_steps": 1})


@pytest.mark.slow
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
@pytest.mark.parametrize("agents", [1, 2, 3])
def test_the_context_of_a_rollout_is_that_of_training(make_store, privileged, arch, agents) -> None:
    """The context of a stored frame equals that of its scene, and has the size given by the spec."""
    store = make_store(agents, 3)
    frame = STEPS + 9  # of episode 1
    for view in views(arch, agents):
        windows, spec = Windows(store, view, privileged, CPU), spec_of(privileged, store, view)
        assert windows.context.shape == (len(view.streams) * store.steps, spec.size(view))
        poses = {
            name: values[0]
            for name, values in ((n, from_quaternion(p[frame : frame + 1])) for n, p in store.poses.items())
        }
        memory = GripperHistory(agents)
        for command in store.action[STEPS:frame, :, 7]:
            memory.record(dict(enumerate(command, start=1)), np.full(agents, OPEN_M))
        for row in range(len(view.streams)):
            live = context(
                spec, view, row, store.qpos[frame].astype(float), poses, memory.vector, spec.world_from_base
            )
            stored = windows.context[row * store.steps + frame].numpy()
            np.testing.assert_allclose(live, stored, atol=1e-5)


def test_context_is_relative_to_the_own_base() -> None:
    """Moving arm and object together over the table does not change it."""
    qpos = np.zeros((1, 9))
    found = []
    for base in ((0.0, 0.0, 0.0), (0.4, -0.2, 1.1)):
        spec = ObservationSpec((base,), ("block",))
        poses = {"block": planar(*base) @ planar(0.5, 0.1, 0.3, 0.02)}
        found.append(context(spec, LOCAL, 0, qpos, poses, GripperHistory(1).vector, spec.world_from_base))
    np.testing.assert_allclose(*found, atol=1e-6)


def test_heights_in_the_context_are_relative_to_the_table() -> None:
    """Over a higher table, the gripper is lower and objects on the table are as high as before."""
    spec, qpos = ObservationSpec(((0.0, 0.0, 0.0),), ("block",)), np.zeros((1, 9))
    poses = {"block": planar(0.5, 0.1, 0.3, 0.02)}
    usual, lower = (
        context(spec, LOCAL, 0, qpos, poses, GripperHistory(1).vector, [planar(0.0, 0.0, 0.0, z_m)])
        for z_m in (0.0, -0.03)
    )
    gripper, block = lower[:3] - usual[:3], slice(POSE_SIZE + HISTORY_SIZE, 2 * POSE_SIZE + HISTORY_SIZE)
    np.testing.assert_allclose(gripper, [0, 0, -0.03], atol=1e-6)
    np.testing.assert_array_equal(lower[block], usual[block])


def test_offsets_near_a_gripper_have_a_fixed_scale() -> None:
    """1 mm from a gripper is 0.01; other features are scaled by their range in the demonstrations."""
    spec, qpos = ObservationSpec(((0.0, 0.0, 0.0),), ("block",)), np.zeros((1, 9))
    tcp_m = tcp_poses(spec, spec.world_from_base, LOCAL.streams[0], qpos[:, :7])[0, :3]

    def offsets_at(*off_m: float) -> np.ndarray:
        pose = planar(0.0, 0.0, 0.0)
        pose[:3, 3] = tcp_m + off_m
        return context(spec, LOCAL, 0, qpos, {"block": pose}, GripperHistory(1).vector, spec.world_from_base)[
            -3:
        ]

    np.testing.assert_allclose(offsets_at(0.001, 0.05, -0.1), [0.01, 0.5, -1.0], atol=1e-6)
    np.testing.assert_allclose(offsets_at(2.4, -0.3, 0.0), [1.0, -1.0, 0.0], atol=1e-6)
    offsets = [[0.001, 0.05, -0.1], [2.4, -0.3, 0.0]]  # keypoints are tensors
    np.testing.assert_allclose(
        clipped_offsets(torch.tensor(offsets)), clipped_offsets(np.array(offsets)), atol=1e-6
    )


def test_poses_survive_as_quaternions() -> None:
    pose = planar(0.3, -0.1, 2.0, 0.4)
    np.testing.assert_allclose(from_quaternion(np.append(pose[:3, 3], quaternion(pose))), pose, atol=1e-12)


def test_a_store_without_poses_is_refused(tmp_path, privileged) -> None:
    episode = replace(make_episode(0, 1), poses={}, images={})
    for name, identity, expected in (
        ("bare", {"task": "reach"}, "the base poses of its arms"),
        (
            "scene",
            {"task": "reach", "scene": {"robots": [{"x_m": 0, "y_m": 0, "yaw_deg": 0}]}},
            "poses of the",
        ),
    ):
        with Store.create(tmp_path / f"{name}.zarr", identity, 1, (), 0, 0) as store:
            store.append(episode)
            with pytest.raises(ArgumentError, match=expected):
                Windows(store, LOCAL, privileged, CPU)


@pytest.mark.slow
def test_a_privileged_state_policy_learns(make_store, privileged, tmp_path) -> None:
    """Without pictures, with the regression trained first; saved and loaded, it reaches the block's goal."""
    refined = {
        "name": "refined",
        "regression.hidden": (64,),
        "regression.dropout": 0.1,
        "diffusion.loss": "l1",
    }
    refined |= {"diffusion.noise_draws": 1, "refined.regression_steps": 500}
    changes = {"relative_actions": True, "binary_grippers": True}
    config = varied(privileged, {f"head.{key}": value for key, value in refined.items()} | changes)
    recipe = small_training(steps=60, batch_size=32, device="cpu")
    train(make_store(1, 40), LOCAL, config, recipe, tmp_path / "agent1")
    policy, view, spec = load_policy(tmp_path / "agent1", "cpu")
    runner = DiffusionRunner(policy, view, spec)
    assert not runner.needs_pictures  # no picture is ever rendered for it
    errors = []
    for seed in range(100, 110):  # not in the demonstrations
        episode = make_episode(seed, 1)
        at = STEPS - 8  # it has arrived before the chunk ends
        scene = scene_at(episode, at)
        runner.reset(seed)
        runner(shown(runner, scene, {}))
        chunk = runner.state.predicted[1]
        assert set(np.unique(chunk[:, 7])) <= {-1.0, 1.0}
        errors.append(np.abs(chunk[-1, :7] - episode.action[at + len(chunk) - 1, 0, :7]).max())
    assert np.median(errors) < 0.05


def test_a_refinement_needs_clean_actions_as_predictions(privileged) -> None:
    with pytest.raises(ArgumentError, match="prediction is 'epsilon'; expected sample"):
        varied(privileged, {"head.name": "refined", "head.diffusion.prediction": "epsilon"})
    with pytest.raises(ArgumentError, match="context is False; expected true"):
        varied(privileged, {"context": False})


def test_a_policy_without_a_regression_has_an_encoder_and_a_unet_only(policy_config) -> None:
    """The paper's network has no further parts."""
    names = {".".join(name.split(".")[:2]) for name, _ in Policy(policy_config, LOCAL).named_parameters()}
    assert names == {"encoder.layers", "head.unet"}
