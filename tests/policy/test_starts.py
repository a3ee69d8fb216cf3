"""Randomised starts of demonstrations: joints, grippers and their features move together."""

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import Policy, PolicyConfig, Stream, Windows, views
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS, HEADING_SIZE
from rf_exp.policy.inputs.observation_spec import ObservationSpec, own_tcp_and_changes, tcp_poses
from rf_exp.policy.networks.keypoint_encoder import KEYPOINT_SIZE
from rf_exp.store import Store
from rf_exp.transforms import Matrix
from rf_exp.types import Arch
from tests.policy.conftest import ARCHS, STEPS, STILL, varied

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def short_approaches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arms of this small world move only a few centimetres."""
    monkeypatch.setattr("rf_exp.policy.examples.starts.APPROACH_M", 0.005)


@pytest.fixture
def with_offsets(policy_config: PolicyConfig) -> PolicyConfig:
    changes = {"encoder.name": "keypoints", "context": True, "crop": 1.0, "observation_steps": 1}
    changes |= {"task_space_actions": True, "relative_actions": True, "start_offset_rad": 0.1, "horizon": 8}
    return varied(policy_config, changes)


def tcps(spec: ObservationSpec, stream: Stream, joints: torch.Tensor) -> torch.Tensor:
    """Poses of the TCPs (..., n, POSE) of joints (..., n, 7)."""
    bases: list[Matrix] = spec.world_from_base
    return torch.from_numpy(tcp_poses(spec, bases, stream, joints.double().numpy())).float()


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_an_arm_with_another_start_joins_the_demonstration(
    make_store, with_offsets: PolicyConfig, arch: Arch
) -> None:
    store: Store = make_store(2, 3)
    for view in views(arch, 2):
        windows = Windows(store, view, with_offsets, CPU)
        chosen = np.arange(len(windows))
        usual, other = windows.batch(chosen, None), windows.batch(chosen, np.random.default_rng(0))
        again = windows.batch(chosen, np.random.default_rng(0))
        assert usual.gripper_offsets is None and other.gripper_offsets is not None
        torch.testing.assert_close(other.context, again.context, rtol=0, atol=0)
        agents = len(view.streams[0].agents)
        for number, stream in enumerate(view.streams):
            first = number * store.steps
            for row in range(agents):
                rows = slice(first, first + store.steps)
                joints = (each.proprio[rows, 0, row * 8 : row * 8 + 7] for each in (usual, other))
                was, now = joints
                moved = (now - was).abs().amax(dim=1)
                step = torch.arange(store.steps) % STEPS
                assert (moved[step < STILL] > 0).all()  # it has not moved yet
                closed = step >= STEPS - 6
                assert (moved[closed] == 0).all()
                torch.testing.assert_close(other.action[rows][closed], usual.action[rows][closed])
                # TCP poses and commands follow the joints; gripper openings do not.
                tcp = own_tcp_and_changes(other.context[rows, 0], row)[0]
                torch.testing.assert_close(
                    tcp,
                    tcps(windows.spec, stream, now.unflatten(1, (1, 7)).repeat(1, agents, 1))[:, row],
                    atol=1e-5,
                    rtol=0,
                )
                command = other.action[rows][..., row * 8 : row * 8 + 7]
                commanded_tcp = other.action[rows][..., agents * 8 + row * 9 :][..., :9]
                torch.testing.assert_close(
                    commanded_tcp,
                    tcps(windows.spec, stream, command[..., None, :].expand(-1, -1, agents, -1))[..., row, :],
                    atol=1e-5,
                    rtol=0,
                )
                torch.testing.assert_close(
                    other.action[rows][..., row * 8 + 7], usual.action[rows][..., row * 8 + 7]
                )
                torch.testing.assert_close(
                    other.proprio[rows, 0, row * 8 + 7], usual.proprio[rows, 0, row * 8 + 7]
                )


def test_an_offset_decreases_as_the_arm_moves_on(make_store, with_offsets: PolicyConfig) -> None:
    windows = Windows(make_store(1, 3), views(ARCHS[3], 1)[0], with_offsets, CPU)
    steps = np.arange(STEPS)
    usual, other = windows.batch(steps, None), windows.batch(steps, np.random.default_rng(1))
    assert windows._start_offsets is not None
    remaining = windows._start_offsets.remaining[:STEPS, 0]
    assert remaining[0] == 1 and (np.diff(remaining) <= 0).all() and remaining[STEPS - 7] == 0
    assert np.ptp(remaining[:STILL]) == 0
    part = (
        ((other.proprio - usual.proprio)[:, 0, :7]).numpy() / np.where(remaining > 0, remaining, 1)[:, None]
    )
    deviations = part[remaining > 0].std()
    assert 0.05 < deviations < 0.2


def test_only_the_present_own_grippers_move_in_the_features(make_store, with_offsets: PolicyConfig) -> None:
    """They move as the labels of an arm with this start would."""
    view = views(ARCHS[3], 2)[1]
    windows = Windows(make_store(2, 3), view, with_offsets, CPU)
    batch = windows.batch(np.arange(4), np.random.default_rng(2))
    policy = Policy(with_offsets, view, windows.spec)
    features = torch.randn(4, 1, policy.encoder.features)
    assert batch.gripper_offsets is not None
    change = policy.encoder.displaced(features, batch.gripper_offsets) - features
    own = windows.spec.keyframes + 1  # after the keyframes of the one own agent
    now = change[:, 0, own * KEYPOINT_SIZE : (own + 1) * KEYPOINT_SIZE]
    assert (now[:, :3].abs().sum(dim=1) > 0).all() and (
        now[:, 3 * len(GRIPPER_POINTS) + HEADING_SIZE :] == 0
    ).all()
    expected = (
        own_tcp_and_changes(batch.context, 0)[0][:, 0, :3]
        - own_tcp_and_changes(windows.batch(np.arange(4), None).context, 0)[0][:, 0, :3]
    )
    torch.testing.assert_close(now[:, :3], expected, atol=1e-5, rtol=0)
    change[:, 0, own * KEYPOINT_SIZE : (own + 1) * KEYPOINT_SIZE] = 0
    assert (change == 0).all()


def test_start_offsets_need_a_keypoint_encoder(policy_config: PolicyConfig) -> None:
    with pytest.raises(
        ArgumentError, match=r"start_offset_rad is 0\.1; expected 0 but with encoder keypoints"
    ):
        varied(policy_config, {"context": True, "start_offset_rad": 0.1})
