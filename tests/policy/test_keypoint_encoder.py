"""Keypoint encoder: labels from demonstrations alone, places finer than a cell, policies that use them."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import (
    DiffusionRunner,
    Policy,
    PolicyConfig,
    Stream,
    TrainConfig,
    Training,
    View,
    Windows,
    load_policy,
    load_runners,
    rollout,
    train,
    views,
)
from rf_exp.policy.config import CELL_PX, KeypointsConfig
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS, keypoints
from rf_exp.policy.examples.windows import Labels, joints_and_commands
from rf_exp.policy.inputs.coordination import may_go_on_mask
from rf_exp.policy.inputs.observation_spec import POSE_SIZE, ObservationSpec, footprint, spec_of, tcp_poses
from rf_exp.policy.inputs.pictures import rays_of, usual_calibration
from rf_exp.policy.inputs.task_space import joint_actions, task_space_actions
from rf_exp.policy.networks.keypoint_encoder import KEYPOINT_SIZE, KeypointEncoder
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim.simulator import CameraModel
from rf_exp.store import Store
from rf_exp.tasks import CameraSpec
from rf_exp.transforms import apply, inverse, planar
from rf_exp.types import Arch, Calibration, RolloutStep
from tests.policy.conftest import ARCHS, HEIGHT, REST, STEPS, WIDTH, make_episode, varied
from tests.policy.test_rollout import Table, judge

CPU = torch.device("cpu")
LOCAL = View("agent1", (Stream("agent1", (1,)),))
USUAL = ObservationSpec()  # all arms are the default robot
CONFIG = KeypointsConfig(1, 0, noise=0.0, steps=0, rate=1.0, shift_px=0, photometric=0.0, dilations=(1, 2, 4))


# Rays of a camera 1 m above the base that looks straight down on 1 m x 1 m of the table.
DOWN = torch.tensor([[1.0, 0.0, -0.5, 0.0], [0.0, -1.0, 0.5, 0.0], [0.0, 0.0, -1.0, 1.0]])[None, None]


def at_height(rays: torch.Tensor, pixels: torch.Tensor, heights: torch.Tensor | float = 0.1) -> torch.Tensor:
    """Points (B, Q, 3) at `heights`, on one camera's rays (B, 1, 3, 4), through the places (B, Q, 2)."""
    along = torch.nn.functional.pad(pixels, (0, 1), value=1.0) @ rays[:, 0, :, :3].mT
    origin = rays[:, 0, None, :, 3]
    return origin + along * ((heights - origin[..., 2]) / along[..., 2])[..., None]


def one_arm() -> KeypointEncoder:
    """Encoder for one arm whose gripper never changes: its keypoints are the gripper at the end, and now."""
    return KeypointEncoder(CONFIG, LOCAL, ObservationSpec(bases=((0.0, 0.0, 0.0),)))


@pytest.fixture
def with_keypoints(policy_config: PolicyConfig) -> PolicyConfig:
    changes = {"encoder.name": "keypoints", "encoder.keypoints.noise": 0.002, "context": True, "crop": 1.0}
    changes |= {"observation_steps": 1, "task_space_actions": True}
    changes |= {"head.name": "refined", "head.regression.hidden": (32,)}
    return varied(policy_config, changes)


@pytest.fixture
def fitted(with_keypoints: PolicyConfig) -> PolicyConfig:
    """The same config, trained in three fits."""
    return varied(with_keypoints, {"encoder.keypoints.steps": 3, "head.refined.regression_steps": 3})


@pytest.fixture
def budget(train_config: TrainConfig) -> TrainConfig:
    return replace(train_config, active_agent_sampling=0.5, steps=3)


def test_policies_without_phases_need_no_subgoals_in_the_store(
    make_store, with_keypoints: PolicyConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A keypoint encoder needs no subgoals; a policy that predicts its phase does."""
    store: Store = make_store(2, 3)
    view = views(ARCHS[0], 2)[0]
    monkeypatch.setitem(store._cache, "subgoal", np.full_like(store.subgoal, -1))
    assert len(Windows(store, view, varied(with_keypoints, {"phases": False}), CPU))
    with pytest.raises(ArgumentError, match="does not record the subgoals of its agents"):
        Windows(store, view, varied(with_keypoints, {"phases": True}), CPU)


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_labels_are_the_future_poses_of_the_own_gripper(
    make_store, with_keypoints: PolicyConfig, arch: Arch
) -> None:
    """Compared with a camera model and kinematics, in frames before and after the gripper closes."""
    agents = 2
    store: Store = make_store(agents, 3)
    scene = store.identity["scene"]
    bases = [planar(r["x_m"], r["y_m"], float(np.deg2rad(r["yaw_deg"]))) for r in scene["robots"]]
    for view in views(arch, agents):
        spec = spec_of(with_keypoints, store, view)
        assert spec.keyframes == 1  # a gripper that closes and stays closed
        for stream in view.streams:
            found = keypoints(store, stream, spec, slice(None))
            assert found.points.shape == (store.steps, spec.keypoints(view) * len(GRIPPER_POINTS), 3)
            assert spec.keypoints(view) == 2 * len(stream.agents) + agents
            eye = CameraSpec(**scene["cameras"][stream.camera])
            camera = CameraModel(WIDTH, HEIGHT, float(np.deg2rad(eye.fov_deg)), eye.world_from_camera)
            all_agents = *stream.agents, *(k for k in range(1, agents + 1) if k not in stream.agents)
            for frame in range(0, store.steps, 7):
                first = frame // STEPS * STEPS  # frame of its episode
                closed = first + int(np.argmax(store.action[first : first + STEPS, 0, 7] < 0))
                moments = [(k, at) for k in stream.agents for at in (closed, first + STEPS - 1)]
                moments += [(k, frame) for k in all_agents]
                for (column, (agent, at)), (part, point) in product(
                    enumerate(moments), enumerate(GRIPPER_POINTS)
                ):
                    index = column * len(GRIPPER_POINTS) + part
                    if at == closed and frame > closed and agent in stream.agents and column % 2 == 0:
                        assert np.isnan(found.points[frame, index]).all()  # a past keyframe has no label
                        continue
                    world = apply(
                        bases[agent - 1] @ DEFAULT.tcp_pose(store.qpos[at, agent - 1]), np.array(point)
                    )
                    local = apply(inverse(bases[stream.agents[0] - 1]), world)
                    np.testing.assert_allclose(found.points[frame, index], local, atol=1e-6)
                    seen = camera.intrinsics @ apply(inverse(camera.world_from_camera), world)
                    pixel = seen[:2] / seen[2] / (WIDTH, HEIGHT)
                    np.testing.assert_allclose(found.pixels[frame, index], pixel, atol=1e-4)


def test_labels_of_several_cameras_are_side_by_side(make_store, with_keypoints: PolicyConfig) -> None:
    """Places are in the part of their camera, or NaN; points and headings are the same for all cameras."""
    store: Store = make_store(2, 3)
    stream = Stream("agent1", (1,), ("global", "agent2"))
    spec = spec_of(with_keypoints, store, View("agent1", (stream,)))
    wide = keypoints(store, stream, spec, slice(None))
    parts = [keypoints(store, Stream(name, (1,)), spec, slice(None)) for name in stream.cameras]
    for row, part in enumerate(parts):
        mine = np.split(wide.pixels, 3, axis=1)[row]
        inside = ((part.pixels >= 0) & (part.pixels <= 1)).all(axis=-1)
        assert inside.any() and np.isnan(mine[~inside]).all()
        np.testing.assert_allclose(mine[inside][:, 0], (part.pixels[inside][:, 0] + row) / 3, atol=1e-6)
        np.testing.assert_allclose(mine[inside][:, 1], part.pixels[inside][:, 1], atol=1e-6)
        np.testing.assert_array_equal(np.split(wide.points, 3, axis=1)[row], part.points)
        np.testing.assert_array_equal(np.split(wide.headings, 3, axis=1)[row], part.headings)


@pytest.mark.slow
@pytest.mark.parametrize("encoder", ["keypoints", "compact"])
@pytest.mark.parametrize(
    "both", [Arch("both", False, False, both_views=True), Arch("all", True, True, both_views=True)]
)
def test_a_policy_with_several_cameras_learns_and_acts(
    make_store, fitted: PolicyConfig, budget: TrainConfig, tmp_path, both: Arch, encoder: str
) -> None:
    config = varied(fitted, {"encoder.name": encoder, "crop": 1.0 if encoder == "keypoints" else 0.9})
    store: Store = make_store(2, 3)
    for view in views(both, 2):
        train(store, view, config, budget, tmp_path / view.name)
        windows = Windows(store, view, config, CPU)
        assert windows.batch(np.array([3]), None).pictures.shape[1:3] == config.cropped(
            HEIGHT, WIDTH * len(view.streams[0].cameras)
        )
    recorded: list[RolloutStep] = []
    rollout(Table(2), judge, load_runners(tmp_path), 1, 2, on_step=recorded.append)
    cameras = {camera for view in views(both, 2) for camera in view.streams[0].cameras}
    assert {sight.camera for sight in recorded[0].detections} == (
        cameras if encoder == "keypoints" else set()
    )


def test_a_camera_on_a_gripper_is_refused(make_store) -> None:
    store: Store = make_store(1, 3)
    store.identity["scene"]["cameras"]["agent1"]["mount"] = "wrist"
    try:
        with pytest.raises(ArgumentError, match="camera 'agent1' is mounted on a gripper"):
            keypoints(
                store, Stream("agent1", (1,)), ObservationSpec(((0.0, 0.0, 0.0),), keyframes=1), slice(None)
            )
    finally:
        store.identity["scene"]["cameras"]["agent1"]["mount"] = "world"


@pytest.mark.parametrize(("x", "y"), [(0.5, 0.5), (0.31, 0.62), (0.08, 0.93)])
def test_a_place_is_read_finer_than_a_cell(x: float, y: float) -> None:
    encoder = one_arm()
    height, width = 24, 32
    rows, columns = torch.arange(height) + 0.5, torch.arange(width) + 0.5
    away = ((columns - x * width) ** 2)[None] + ((rows - y * height) ** 2)[:, None]
    maps = -away[None, None].expand(1, 2 * len(GRIPPER_POINTS), -1, -1) / 0.8
    read = encoder.read_out(maps, torch.zeros(1, 32, height, width), DOWN)
    assert (read.places[0, 0] * torch.tensor([width, height])).tolist() == pytest.approx(
        [x * width, y * height], abs=0.1
    )


@pytest.mark.slow
def test_it_learns_to_localise_keypoints() -> None:
    """To within a pixel after a hundred steps, with cells of four pixels; also the subgoal of another arm."""
    torch.manual_seed(0)
    spec = ObservationSpec(
        bases=((0.0, 0.0, 0.0),) * 2, subgoals=2
    )  # with another arm, which is never in the picture
    encoder, rng = KeypointEncoder(CONFIG, LOCAL, spec), np.random.default_rng(0)
    optimiser = torch.optim.AdamW(encoder.parameters(), 4e-3)

    def samples(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        places = rng.uniform(0.15, 0.85, (count, len(GRIPPER_POINTS), 2))
        subgoals = rng.integers(0, 2, (count, 1))
        pictures = np.full((count, 3, 48, 64), -0.2, np.float32)
        rows, columns = np.mgrid[:48, :64] + 0.5
        for picture, gripper, (blended,) in zip(pictures, places, subgoals, strict=True):
            for colour, (x, y) in enumerate(gripper):
                picture[colour] += np.exp(-((columns - 64 * x) ** 2 + (rows - 48 * y) ** 2) / 8)
            picture[2] += blended * (picture[0] + 0.2)
        places = np.pad(places, ((0, 0), (0, 2 * len(GRIPPER_POINTS)), (0, 0)), constant_values=np.nan)
        places = places.astype(np.float32)
        return torch.from_numpy(pictures), torch.from_numpy(places), torch.from_numpy(subgoals)

    _, pixels, _ = samples(200)
    encoder.fit_points(pixels, at_height(DOWN, pixels))
    for _ in range(100):
        pictures, pixels, subgoals = samples(16)
        pixels[0, 0] = torch.nan  # a past keyframe
        labels = Labels(pixels, at_height(DOWN, pixels), torch.zeros(16, 3, 6), subgoals)
        loss = encoder.loss(pictures, DOWN.expand(16, -1, -1, -1), labels)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    pictures, pixels, subgoals = samples(64)
    other_rays = torch.cat([DOWN[..., :3], DOWN[..., 3:] + torch.tensor([0.1, -0.2, 0.3])[:, None]], 3)
    features, places = encoder.eval().encode(pictures, other_rays.expand(64, -1, -1, -1))  # unseen rays
    found = encoder.read_out(*encoder.heat_maps(pictures), DOWN.expand(64, -1, -1, -1)).places
    own = slice(len(GRIPPER_POINTS))
    pixels = pixels[:, own]
    error = (found[:, own] - pixels) * torch.tensor([64, 48])
    assert error.norm(dim=2).quantile(0.9) < CELL_PX / 4
    assert (features[:, -2:].argmax(dim=1, keepdim=True) == subgoals).float().mean() > 0.9
    assert places is not None and torch.equal(places, found)
    points, expected = (
        features[:, : 3 * len(GRIPPER_POINTS)].unflatten(1, (-1, 3)),
        at_height(other_rays, pixels),
    )
    expected[:, 1:] -= expected[:, :1]
    assert (points - expected).norm(dim=2).median() < 0.03


def test_labels_move_with_a_shifted_picture(make_store, with_keypoints: PolicyConfig) -> None:
    """Shifted places and rays still meet at the labelled points, and pixels are shifted by as much."""
    windows = Windows(make_store(1, 3), LOCAL, with_keypoints, CPU)
    chosen, rng = np.arange(0, len(windows), 3), np.random.default_rng(0)
    pictures, rays, labels = windows.labelled(chosen)
    shifted, turned, moved = windows.labelled(chosen, 8, rng)
    heights = labels.points[..., 2]
    for seen, by_rays in ((labels, rays), (moved, turned)):
        np.testing.assert_allclose(at_height(by_rays, seen.pixels, heights), labels.points, atol=1e-4)
    shifts = ((moved.pixels - labels.pixels) * torch.tensor([WIDTH, HEIGHT])).round().int()[:, -1]
    assert len(shifts.unique(dim=0)) > 20 and shifts.abs().max() == 8
    for before, after, (right, down) in zip(pictures, shifted, shifts.tolist(), strict=True):
        rows, columns = np.mgrid[8 : HEIGHT - 8, 8 : WIDTH - 8]
        assert torch.equal(after[rows + down, columns + right], before[rows, columns])


def test_part_of_a_batch_is_sampled_where_the_agent_may_go_on(
    make_store, with_keypoints: PolicyConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The given part of them; the others are the next ones in order.

    Their weights restore the distribution of all windows.
    """
    store: Store = make_store(2, 3)
    action, executed = np.array(store.action), np.array(store.executed)
    first, last = store.by_episode(np.arange(store.steps))[1][[0, -10]]
    action[first:last, 0] = executed[first:last, 0] = action[first, 0]  # agent 1 holds still
    monkeypatch.setitem(store._cache, "action", action)
    monkeypatch.setitem(store._cache, "executed", executed)
    windows = Windows(store, LOCAL, with_keypoints, CPU)
    every = np.random.default_rng(1).integers(0, store.steps, 8000)
    assert np.array_equal(windows.sample_active(every, 0.0, np.random.default_rng(0))[0], every)
    drawn, weights = windows.sample_active(every, 0.75, np.random.default_rng(0))
    part = 6000
    assert np.array_equal(drawn[part:], every[part:])
    free = np.concatenate([may_go_on_mask(*episode) for episode in joints_and_commands(store)])[:, 0]
    assert set(drawn[:part]) <= set(np.flatnonzero(free)) and not free.all()
    assert len(set(drawn[:part])) == free.sum()
    assert (weights * torch.from_numpy(free[drawn])).mean() == pytest.approx(free.mean(), rel=0.1)
    assert weights.mean() == pytest.approx(1.0, rel=0.1)


def test_points_outside_the_picture_have_no_loss() -> None:
    encoder, nowhere = one_arm(), torch.full((2, 2 * len(GRIPPER_POINTS), 2), torch.nan)
    points = torch.zeros(2, 2 * len(GRIPPER_POINTS), 3)
    labels = Labels(nowhere, points, torch.zeros(2, 2, 6), torch.zeros(2, 0))
    loss = encoder.loss(torch.zeros(2, 3, 32, 48), DOWN.expand(2, -1, -1, -1), labels)
    encoder.fit_points(nowhere, points)
    assert not encoder.centre.any()
    loss.backward()
    assert loss.item() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("saved_at", range(1, 9))
def test_training_resumes_from_every_step(
    make_store, fitted: PolicyConfig, budget: TrainConfig, tmp_path: Path, saved_at: int
) -> None:
    store = make_store(1, 3)

    def begun() -> Training:
        return Training(Windows(store, LOCAL, fitted, CPU), LOCAL, fitted, budget)

    straight, early, late = begun(), begun(), begun()
    while early.step_number < saved_at:
        early.step()
    early.save(tmp_path / "state")
    late.resume(tmp_path / "state")
    for training in (straight, late):
        while not training.done:
            training.step()
    assert straight.steps == 9
    weights = late.averaged().state_dict()
    assert all(torch.equal(value, weights[n]) for n, value in straight.averaged().state_dict().items())


@pytest.mark.slow
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_policies_of_all_views_save_and_load(
    make_store, fitted: PolicyConfig, budget: TrainConfig, tmp_path: Path, arch: Arch
) -> None:
    store: Store = make_store(2, 3)
    for view in views(arch, 2):
        folder = train(store, view, fitted, budget, tmp_path / view.name)
        policy, read, spec = load_policy(folder)
        assert (read, spec) == (view, spec_of(fitted, store, view))
        windows = Windows(store, view, fitted, CPU)
        batch = windows.batch(np.arange(4), None)
        features = policy.encode_centre_crops(batch.pictures, batch.rays)[0][batch.frames]
        generators = [torch.Generator().manual_seed(k) for k in range(4)]
        actions = policy.act(features, batch.proprio, batch.context, generators)
        assert actions.shape == (4, fitted.horizon, view.action_size // 8 * 17)
        assert torch.isfinite(actions).all()


def test_joints_follow_the_predicted_grippers() -> None:
    """Joints that are a little off are corrected to the predicted gripper poses, both arms of a stream."""
    rng = np.random.default_rng(3)
    bases = [planar(0.0, -0.6, 1.5), planar(0.5, 0.6, -1.5)]
    stream = Stream("global", (1, 2))
    action = np.concatenate([REST + rng.normal(0, 0.2, (12, 2, 7)), rng.choice([-1.0, 1.0], (12, 2, 1))], 2)
    action[..., :7] = np.clip(action[..., :7], DEFAULT.limits_rad[0] + 0.1, DEFAULT.limits_rad[1] - 0.1)
    chunk = task_space_actions(USUAL, bases, stream, action).astype(float)
    chunk[:, :16] += np.tile(np.append(rng.normal(0, 0.01, 7), 0.0), 2)
    found = joint_actions(USUAL, bases, stream, chunk)
    assert np.array_equal(found[..., 7], action[..., 7])
    np.testing.assert_allclose(
        tcp_poses(USUAL, bases, stream, found[..., :7]),
        tcp_poses(USUAL, bases, stream, action[..., :7]),
        atol=2e-3,
    )
    assert np.abs(found - action)[..., :7].max() < 0.1


def test_grippers_keep_their_height_above_the_table() -> None:
    """With a lower base, the policy observes objects on the table as before, and the joints compensate."""
    stream, action = Stream("agent1", (1,)), np.append(REST, 1.0)[None, None]
    usual, lower = [planar(0.1, -0.6, 1.5)], [planar(0.1, -0.6, 1.5, -0.03)]
    chunk = task_space_actions(USUAL, usual, stream, action).astype(float)
    direct = task_space_actions(USUAL, lower, stream, action)
    np.testing.assert_allclose(chunk[0, 8:11] - direct[0, 8:11], [0, 0, 0.03], atol=1e-6)
    above = Arm(DEFAULT, lower[0]).tcp(joint_actions(USUAL, lower, stream, chunk)[0, 0, :7])
    np.testing.assert_allclose(above, Arm(DEFAULT, usual[0]).tcp(action[0, 0, :7]), atol=1e-3)
    camera = CameraModel(64, 48, 1.0, CameraSpec((0.5, 0.0, 0.9)).world_from_camera)
    high, low = (rays_of(Calibration(tuple(bases), {"agent1": camera}), stream) for bases in (usual, lower))
    np.testing.assert_array_equal(high, low)


def test_grippers_out_of_reach_leave_the_joints_as_they_are() -> None:
    bases, stream = [planar(0.0, 0.0, 0.0)], Stream("agent1", (1,))
    chunk = task_space_actions(USUAL, bases, stream, np.append(REST, 1.0)[None, None]).astype(float)
    chunk[0, 8:11] = (3.0, 0.0, 0.5)
    assert np.array_equal(joint_actions(USUAL, bases, stream, chunk)[0, 0], chunk[0, :8])


@pytest.mark.parametrize("changes", [0, 1])
def test_an_open_goal_gate_makes_positions_relative_to_the_next_keypoint(
    with_keypoints: PolicyConfig, changes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = ObservationSpec(bases=((0.0, 0.0, 0.0),), keyframes=2)
    policy = Policy(varied(with_keypoints, {"goal_gate": True, "relative_actions": True}), LOCAL, spec).eval()
    assert policy.gate is not None
    last = policy.gate.layers[-2]
    assert isinstance(last, torch.nn.Linear) and policy.normaliser.action.centre.abs().max() == 0
    features = torch.randn(1, 1, policy.encoder.features)
    seen = features[0, 0, changes * KEYPOINT_SIZE :][:3]
    context = torch.zeros(1, 1, spec.size(LOCAL))
    context[..., :POSE_SIZE], context[..., POSE_SIZE + changes] = torch.randn(POSE_SIZE), 1.0
    horizon, actions = policy.config.horizon, len(policy.normaliser.action.centre)
    monkeypatch.setattr(policy.head, "sample", lambda *_: torch.zeros(1, horizon, actions))
    nearer = torch.tensor([[[0.0, 0.02, -0.01]]])
    cases = ((-50.0, 0.0, context[0, 0, :3]), (50.0, 0.0, seen))
    cases += ((-50.0, nearer, context[0, 0, :3]), (50.0, nearer, seen + nearer[0, 0]))
    for bias, beyond, expected in cases:
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.constant_(last.bias, bias)
        chunk = policy.act(features, torch.zeros(1, 1, 8), context, [torch.Generator()], beyond)[0]
        place, axes = chunk[:, 8:11], chunk[:, 11:]
        torch.testing.assert_close(place, expected.expand(horizon, 3))
        torch.testing.assert_close(axes, context[0, 0, 3:POSE_SIZE].expand(horizon, 6))


def test_a_goal_gate_learns_with_the_first_fit_of_the_head(make_store, fitted: PolicyConfig) -> None:
    gated = varied(fitted, {"goal_gate": True, "relative_actions": True})
    store: Store = make_store(2, 3)
    for view in views(ARCHS[0], 2):
        windows = Windows(store, view, gated, CPU)
        policy = Policy(gated, view, windows.spec)
        assert [policy.gate in fit.parts for fit in policy.fits(windows)] == [False, True, False]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"goal_gate": True, "relative_actions": False},
            "goal_gate is True; expected false but with encoder",
        ),
        ({"crop": 0.9}, "encoder is 'keypoints'; expected context=true and crop=1 with keypoints"),
        (
            {"context": False, "encoder.name": "compact"},
            "context is False; expected true with task_space_actions",
        ),
        ({"encoder.keypoints.noise": -0.1}, "noise is -0.1; expected 0 or above"),
    ],
)
def test_keys_that_do_not_fit_are_refused(with_keypoints: PolicyConfig, change: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        varied(with_keypoints, change)


@pytest.mark.slow
def test_detections_are_reported_with_the_step(
    make_store, fitted: PolicyConfig, budget: TrainConfig, tmp_path
) -> None:
    """Per stream, the keyframes of its agents that are not past, one of them the next, and the other arms."""
    store: Store = make_store(2, 3)
    for view in views(Arch("separate_local", False, False), 2):
        train(store, view, fitted, budget, tmp_path / view.name)
    recorded: list[RolloutStep] = []
    rollout(Table(2), judge, load_runners(tmp_path), 1, 2, on_step=recorded.append)
    for step in recorded:
        own = {"agent1": 1, "agent2": 2}
        assert {sight.camera for sight in step.detections} == {*own}
        for camera, agent in own.items():
            sights = [sight for sight in step.detections if sight.camera == camera]
            assert [sight.agent for sight in sights] == [agent, agent, 3 - agent]  # its own pose is known
            assert [sight.is_next for sight in sights] == [True, False, False]
            assert all(0 <= place <= 1 for sight in sights for place in (sight.x, sight.y))


@pytest.mark.parametrize("names", [("agent1",), ("agent1", "global")])
def test_rays_invert_the_projection_of_a_camera(names: tuple[str, ...]) -> None:
    """Projected points are recovered at their height, for bases at random poses."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 0.2), (50, 3))
    for _ in range(20):
        x_m, y_m, yaw_rad, z_m = rng.uniform((-0.8, -0.8, -3, -0.03), (0.8, 0.8, 3, 0.03))
        base = planar(x_m, y_m, yaw_rad, z_m)
        cameras = {}
        for name in names:
            x_m, y_m = rng.uniform(-1, 1, 2)
            pose = CameraSpec((x_m, y_m, 0.9)).world_from_camera
            cameras[name] = CameraModel(64, 48, rng.uniform(0.7, 1.4), pose)
        calibration = Calibration((base,), cameras)
        rays = rays_of(calibration, Stream("agent1", (1,), names[1:]))
        local = apply(inverse(footprint(base)), points)
        for row, (name, ray) in enumerate(zip(names, rays, strict=True)):
            seen = apply(inverse(cameras[name].world_from_camera), points) @ cameras[name].intrinsics.T
            places = seen[:, :2] / seen[:, 2:] / (64, 48)
            places[:, 0] = (places[:, 0] + row) / len(names)
            inputs = ray[None], places.astype(np.float32), local[:, 2].astype(np.float32)
            found = at_height(*(torch.from_numpy(each)[None] for each in inputs))
            np.testing.assert_allclose(found[0], local, atol=2e-4)


def test_features_depend_on_the_given_calibration(make_store, with_keypoints: PolicyConfig) -> None:
    """None is the usual calibration; with another base, the same picture gives other features."""
    store: Store = make_store(1, 3)
    spec = spec_of(with_keypoints, store, LOCAL)
    torch.manual_seed(0)
    policy = Policy(with_keypoints, LOCAL, spec)
    assert isinstance(policy.encoder, KeypointEncoder)
    policy.encoder.fit(Windows(store, LOCAL, with_keypoints, CPU))
    runner = DiffusionRunner(policy, LOCAL, spec)
    assert runner.declaration is not None and runner.declaration.calibrated
    usual = usual_calibration(store, ("agent1",))
    moved = replace(usual, world_from_base=(planar(0.1, 0.0, 0.0) @ usual.world_from_base[0],))
    pictures = torch.from_numpy(make_episode(0, 1).images["agent1"][:1])
    both_rays = (torch.from_numpy(rays_of(each, LOCAL.streams[0]))[None] for each in (usual, moved))
    seen = [policy.encode_centre_crops(pictures, rays) for rays in (None, *both_rays)]
    before, same, after = (features for features, _ in seen)
    assert torch.equal(before, same) and not torch.allclose(before, after)


def overhead(x_m: float, y_m: float) -> torch.Tensor:
    """Rays of a camera 1 m above the table."""
    return DOWN + torch.nn.functional.pad(torch.tensor([x_m, y_m, 0.0])[:, None], (3, 0))


def test_two_rays_meet_whatever_the_given_height() -> None:
    """With two cameras that see a point, the given height hardly matters; with one, it decides."""
    view = View("agent1", (Stream("agent1", (1,), ("global",)),))
    both = KeypointEncoder(CONFIG, view, ObservationSpec(bases=((0.0, 0.0, 0.0),)))
    both.height_error.fill_(0.03)
    rays = torch.cat([overhead(0.0, 0.0), overhead(0.4, 0.1)], dim=1)
    points = torch.rand(50, both.keypoints * len(GRIPPER_POINTS), 3) * 0.3
    places = []
    for ray in rays[0]:
        seen = (points - ray[:, 3]) @ torch.linalg.inv(ray[:, :3]).T
        places.append(seen[..., :2] / seen[..., 2:])
    rays, places = rays.expand(50, -1, -1, -1), torch.cat(places, dim=1)
    wrong_m = points[..., 2] + 0.02
    confidence = torch.ones(50, 2, both.keypoints)
    assert (both.triangulate(rays, places, confidence.flatten(1), wrong_m) - points).norm(dim=2).max() < 0.007
    confidence[:, 1] = 1e-4  # it is not in the second picture
    alone = both.triangulate(rays, places, confidence.flatten(1), wrong_m)
    expected = at_height(rays, places[:, : points.shape[1]], wrong_m)
    assert (alone - expected).norm(dim=2).max() < 0.002


def test_a_ray_that_never_reaches_its_height_gives_a_finite_point() -> None:
    encoder = one_arm()
    level = torch.tensor([[0.0, 0.0, 1.0, 0.5], [1.0, 0.0, -0.5, 0.0], [0.0, -1.0, 0.5, 1.0]])[None, None]
    places = torch.full((1, 2 * len(GRIPPER_POINTS), 2), 0.5).requires_grad_()
    heights = torch.full((1, 2 * len(GRIPPER_POINTS)), 0.1)
    points = encoder.triangulate(level, places, torch.ones(1, 2), heights)
    points.sum().backward()
    assert places.grad is not None and torch.isfinite(places.grad).all() and points.abs().max() < 2
