"""The keypoint encoder: labels from demonstrations alone, places finer than a cell, a policy led by them."""

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
USUAL = ObservationSpec()  # all arms are the usual one
CONFIG = KeypointsConfig(1, 0, noise=0.0, steps=0, rate=1.0, shift_px=0, photometric=0.0, dilations=(1, 2, 4))


# A camera 1 m above the base, which looks straight down on 1 m x 1 m of the table.
DOWN = torch.tensor([[1.0, 0.0, -0.5, 0.0], [0.0, -1.0, 0.5, 0.0], [0.0, 0.0, -1.0, 1.0]])[None, None]


def at_height(rays: torch.Tensor, pixels: torch.Tensor, heights: torch.Tensor | float = 0.1) -> torch.Tensor:
    """The points (B, Q, 3) where one camera, of rays (B, 1, 3, 4), sees these places (B, Q, 2)."""
    along = torch.nn.functional.pad(pixels, (0, 1), value=1.0) @ rays[:, 0, :, :3].mT
    origin = rays[:, 0, None, :, 3]
    return origin + along * ((heights - origin[..., 2]) / along[..., 2])[..., None]


def one_arm() -> KeypointEncoder:
    """Of a task of one arm whose gripper never changes: its hand at the end, and now."""
    return KeypointEncoder(CONFIG, LOCAL, ObservationSpec(bases=((0.0, 0.0, 0.0),)))


@pytest.fixture
def seeing(policy_config: PolicyConfig) -> PolicyConfig:
    changes = {"encoder.name": "keypoints", "encoder.keypoints.noise": 0.002, "context": True, "crop": 1.0}
    changes |= {"observation_steps": 1, "task_space_actions": True}
    changes |= {"head.name": "refined", "head.regression.hidden": (32,)}
    return varied(policy_config, changes)


@pytest.fixture
def fitted(seeing: PolicyConfig) -> PolicyConfig:
    """The same, in three fits."""
    return varied(seeing, {"encoder.keypoints.steps": 3, "head.refined.regression_steps": 3})


@pytest.fixture
def budget(train_config: TrainConfig) -> TrainConfig:
    return replace(train_config, active_agent_sampling=0.5, steps=3)


def test_who_is_not_told_of_subgoals_learns_from_a_store_that_does_not_say(
    make_store, seeing: PolicyConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A keypoint encoder needs none; a policy that predicts its phase does."""
    store: Store = make_store(2, 3)
    view = views(ARCHS[0], 2)[0]
    monkeypatch.setitem(store._cache, "subgoal", np.full_like(store.subgoal, -1))
    assert len(Windows(store, view, varied(seeing, {"phases": False}), CPU))
    with pytest.raises(ArgumentError, match="does not record the subgoals of its agents"):
        Windows(store, view, varied(seeing, {"phases": True}), CPU)


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_labels_are_where_the_own_hand_will_be(make_store, seeing: PolicyConfig, arch: Arch) -> None:
    """Compared with a camera model and kinematics, episode by episode, in frames of every kind."""
    agents = 2
    store: Store = make_store(agents, 3)
    scene = store.identity["scene"]
    bases = [planar(r["x_m"], r["y_m"], float(np.deg2rad(r["yaw_deg"]))) for r in scene["robots"]]
    for view in views(arch, agents):
        spec = spec_of(seeing, store, view)
        assert spec.keyframes == 1  # a gripper that closes, and stays so
        for stream in view.streams:
            found = keypoints(store, stream, spec, slice(None))
            assert found.points.shape == (store.steps, spec.keypoints(view) * len(GRIPPER_POINTS), 3)
            assert spec.keypoints(view) == 2 * len(stream.agents) + agents
            eye = CameraSpec(**scene["cameras"][stream.camera])
            camera = CameraModel(WIDTH, HEIGHT, float(np.deg2rad(eye.fov_deg)), eye.world_from_camera)
            hands = *stream.agents, *(k for k in range(1, agents + 1) if k not in stream.agents)
            for frame in range(0, store.steps, 7):
                first = frame // STEPS * STEPS  # of its episode
                closed = first + int(np.argmax(store.action[first : first + STEPS, 0, 7] < 0))
                moments = [(k, at) for k in stream.agents for at in (closed, first + STEPS - 1)]
                moments += [(k, frame) for k in hands]
                for (column, (agent, at)), (part, point) in product(
                    enumerate(moments), enumerate(GRIPPER_POINTS)
                ):
                    mine = column * len(GRIPPER_POINTS) + part
                    if at == closed and frame > closed and agent in stream.agents and column % 2 == 0:
                        assert np.isnan(found.points[frame, mine]).all()  # it is past
                        continue
                    world = apply(
                        bases[agent - 1] @ DEFAULT.tcp_pose(store.qpos[at, agent - 1]), np.array(point)
                    )
                    local = apply(inverse(bases[stream.agents[0] - 1]), world)
                    np.testing.assert_allclose(found.points[frame, mine], local, atol=1e-6)
                    seen = camera.intrinsics @ apply(inverse(camera.world_from_camera), world)
                    pixel = seen[:2] / seen[2] / (WIDTH, HEIGHT)
                    np.testing.assert_allclose(found.pixels[frame, mine], pixel, atol=1e-4)


def test_labels_of_several_cameras_stand_side_by_side(make_store, seeing: PolicyConfig) -> None:
    """Each camera's in its part of the picture, or nowhere; and a keypoint is the same in all of them."""
    store: Store = make_store(2, 3)
    stream = Stream("agent1", (1,), ("global", "agent2"))
    spec = spec_of(seeing, store, View("agent1", (stream,)))
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
def test_who_looks_through_several_cameras_learns_and_acts(
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
    told: list[RolloutStep] = []
    rollout(Table(2), judge, load_runners(tmp_path), 1, 2, on_step=told.append)
    cameras = {camera for view in views(both, 2) for camera in view.streams[0].cameras}
    assert {sight.camera for sight in told[0].detections} == (cameras if encoder == "keypoints" else set())


def test_a_camera_on_a_hand_is_refused(make_store) -> None:
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
def test_it_learns_to_find_what_is_shown() -> None:
    """Within a pixel, after a hundred steps, where a cell is four pixels wide; and at what another one is."""
    torch.manual_seed(0)
    spec = ObservationSpec(
        bases=((0.0, 0.0, 0.0),) * 2, subgoals=2
    )  # another arm, which is never in the picture
    encoder, rng = KeypointEncoder(CONFIG, LOCAL, spec), np.random.default_rng(0)
    optimiser = torch.optim.AdamW(encoder.parameters(), 4e-3)

    def shown(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        places = rng.uniform(0.15, 0.85, (count, len(GRIPPER_POINTS), 2))
        doing = rng.integers(0, 2, (count, 1))
        pictures = np.full((count, 3, 48, 64), -0.2, np.float32)
        rows, columns = np.mgrid[:48, :64] + 0.5
        for picture, hand, (left_behind,) in zip(pictures, places, doing, strict=True):
            for colour, (x, y) in enumerate(hand):
                picture[colour] += np.exp(-((columns - 64 * x) ** 2 + (rows - 48 * y) ** 2) / 8)
            picture[2] += left_behind * (picture[0] + 0.2)
        places = np.pad(places, ((0, 0), (0, 2 * len(GRIPPER_POINTS)), (0, 0)), constant_values=np.nan)
        places = places.astype(np.float32)
        return torch.from_numpy(pictures), torch.from_numpy(places), torch.from_numpy(doing)

    _, pixels, _ = shown(200)
    encoder.fit_points(pixels, at_height(DOWN, pixels))
    for _ in range(100):
        pictures, pixels, doing = shown(16)
        pixels[0, 0] = torch.nan  # past
        labels = Labels(pixels, at_height(DOWN, pixels), torch.zeros(16, 3, 6), doing)
        loss = encoder.loss(pictures, DOWN.expand(16, -1, -1, -1), labels)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    pictures, pixels, doing = shown(64)
    there = torch.cat([DOWN[..., :3], DOWN[..., 3:] + torch.tensor([0.1, -0.2, 0.3])[:, None]], 3)
    features, places = encoder.eval().encode(pictures, there.expand(64, -1, -1, -1))  # where nobody learned
    found = encoder.read_out(*encoder.heat_maps(pictures), DOWN.expand(64, -1, -1, -1)).places
    own = slice(len(GRIPPER_POINTS))
    pixels = pixels[:, own]
    off = (found[:, own] - pixels) * torch.tensor([64, 48])
    assert off.norm(dim=2).quantile(0.9) < CELL_PX / 4
    assert (features[:, -2:].argmax(dim=1, keepdim=True) == doing).float().mean() > 0.9
    assert places is not None and torch.equal(places, found)
    points, expected = features[:, : 3 * len(GRIPPER_POINTS)].unflatten(1, (-1, 3)), at_height(there, pixels)
    expected[:, 1:] -= expected[:, :1]
    assert (points - expected).norm(dim=2).median() < 0.03


def test_what_is_seen_moves_with_a_shifted_picture(make_store, seeing: PolicyConfig) -> None:
    """Wherever a keypoint still is in the picture, the same colours are round it as before."""
    windows = Windows(make_store(1, 3), LOCAL, seeing, CPU)
    chosen, rng = np.arange(0, len(windows), 3), np.random.default_rng(0)
    pictures, rays, labels = windows.labelled(chosen)
    shifted, turned, moved = windows.labelled(chosen, 8, rng)
    heights = labels.points[..., 2]
    for seen, by_rays in ((labels, rays), (moved, turned)):
        np.testing.assert_allclose(at_height(by_rays, seen.pixels, heights), labels.points, atol=1e-4)
    by = ((moved.pixels - labels.pixels) * torch.tensor([WIDTH, HEIGHT])).round().int()[:, -1]
    assert len(by.unique(dim=0)) > 20 and by.abs().max() == 8
    for before, after, (right, down) in zip(pictures, shifted, by.tolist(), strict=True):
        rows, columns = np.mgrid[8 : HEIGHT - 8, 8 : WIDTH - 8]
        assert torch.equal(after[rows + down, columns + right], before[rows, columns])


def test_pictures_are_drawn_from_those_in_which_the_agent_may_go(
    make_store, seeing: PolicyConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As large a part of them as is said; the rest are those that were to come, in their order.

    Counted by their weights they are as all windows are.
    """
    store: Store = make_store(2, 3)
    action, executed = np.array(store.action), np.array(store.executed)
    first, last = store.by_episode(np.arange(store.steps))[1][[0, -10]]
    action[first:last, 0] = executed[first:last, 0] = action[first, 0]  # agent 1 is sent nowhere
    monkeypatch.setitem(store._cache, "action", action)
    monkeypatch.setitem(store._cache, "executed", executed)
    windows = Windows(store, LOCAL, seeing, CPU)
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


def test_nothing_to_see_is_nothing_to_learn() -> None:
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
def test_every_step_can_be_gone_on_from(
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


def test_joints_follow_the_hands() -> None:
    """Joints that are a little off are led to where the predicted hands are, both arms of a stream."""
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


def test_hands_go_as_high_above_the_table_however_high_that_is() -> None:
    """What stands on the table is where it was to the policy; the joints are those that reach so low."""
    stream, action = Stream("agent1", (1,)), np.append(REST, 1.0)[None, None]
    usual, lower = [planar(0.1, -0.6, 1.5)], [planar(0.1, -0.6, 1.5, -0.03)]
    chunk = task_space_actions(USUAL, usual, stream, action).astype(float)
    said = task_space_actions(USUAL, lower, stream, action)
    np.testing.assert_allclose(chunk[0, 8:11] - said[0, 8:11], [0, 0, 0.03], atol=1e-6)
    above = Arm(DEFAULT, lower[0]).tcp(joint_actions(USUAL, lower, stream, chunk)[0, 0, :7])
    np.testing.assert_allclose(above, Arm(DEFAULT, usual[0]).tcp(action[0, 0, :7]), atol=1e-3)
    camera = CameraModel(64, 48, 1.0, CameraSpec((0.5, 0.0, 0.9)).world_from_camera)
    high, low = (rays_of(Calibration(tuple(bases), {"agent1": camera}), stream) for bases in (usual, lower))
    np.testing.assert_array_equal(high, low)


def test_hands_out_of_reach_leave_the_joints_as_they_are() -> None:
    bases, stream = [planar(0.0, 0.0, 0.0)], Stream("agent1", (1,))
    chunk = task_space_actions(USUAL, bases, stream, np.append(REST, 1.0)[None, None]).astype(float)
    chunk[0, 8:11] = (3.0, 0.0, 0.5)
    assert np.array_equal(joint_actions(USUAL, bases, stream, chunk)[0, 0], chunk[0, :8])


@pytest.mark.parametrize("changes", [0, 1])
def test_an_open_goal_gate_tells_poses_from_where_the_gripper_changes_next(
    seeing: PolicyConfig, changes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = ObservationSpec(bases=((0.0, 0.0, 0.0),), keyframes=2)
    policy = Policy(varied(seeing, {"goal_gate": True, "relative_actions": True}), LOCAL, spec).eval()
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
def test_what_does_not_fit_is_refused(seeing: PolicyConfig, change: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        varied(seeing, change)


@pytest.mark.slow
def test_what_is_seen_is_told_with_the_step(
    make_store, fitted: PolicyConfig, budget: TrainConfig, tmp_path
) -> None:
    """Of each stream its agents' keyframes that are not past, one of them the next, and the other arms."""
    store: Store = make_store(2, 3)
    for view in views(Arch("separate_local", False, False), 2):
        train(store, view, fitted, budget, tmp_path / view.name)
    told: list[RolloutStep] = []
    rollout(Table(2), judge, load_runners(tmp_path), 1, 2, on_step=told.append)
    for step in told:
        own = {"agent1": 1, "agent2": 2}
        assert {sight.camera for sight in step.detections} == {*own}
        for camera, agent in own.items():
            sights = [sight for sight in step.detections if sight.camera == camera]
            assert [sight.agent for sight in sights] == [agent, agent, 3 - agent]  # its own hand it knows
            assert [sight.is_next for sight in sights] == [True, False, False]
            assert all(0 <= place <= 1 for sight in sights for place in (sight.x, sight.y))


@pytest.mark.parametrize("names", [("agent1",), ("agent1", "global")])
def test_rays_meet_what_a_camera_sees(names: tuple[str, ...]) -> None:
    """Points that are projected, and met again at their height, from a base that may stand anywhere."""
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
        stands = Calibration((base,), cameras)
        rays = rays_of(stands, Stream("agent1", (1,), names[1:]))
        local = apply(inverse(footprint(base)), points)
        for row, (name, ray) in enumerate(zip(names, rays, strict=True)):
            seen = apply(inverse(cameras[name].world_from_camera), points) @ cameras[name].intrinsics.T
            places = seen[:, :2] / seen[:, 2:] / (64, 48)
            places[:, 0] = (places[:, 0] + row) / len(names)
            asked = ray[None], places.astype(np.float32), local[:, 2].astype(np.float32)
            found = at_height(*(torch.from_numpy(each)[None] for each in asked))
            np.testing.assert_allclose(found[0], local, atol=2e-4)


def test_a_policy_sees_by_the_calibration_that_it_is_handed(make_store, seeing: PolicyConfig) -> None:
    """None is the usual one; from a base that stands elsewhere the same things are elsewhere."""
    store: Store = make_store(1, 3)
    spec = spec_of(seeing, store, LOCAL)
    torch.manual_seed(0)
    policy = Policy(seeing, LOCAL, spec)
    assert isinstance(policy.encoder, KeypointEncoder)
    policy.encoder.fit(Windows(store, LOCAL, seeing, CPU))
    runner = DiffusionRunner(policy, LOCAL, spec)
    assert runner.declaration is not None and runner.declaration.calibrated
    usual = usual_calibration(store, ("agent1",))
    moved = replace(usual, world_from_base=(planar(0.1, 0.0, 0.0) @ usual.world_from_base[0],))
    pictures = torch.from_numpy(make_episode(0, 1).images["agent1"][:1])
    stands = (torch.from_numpy(rays_of(each, LOCAL.streams[0]))[None] for each in (usual, moved))
    seen = [policy.encode_centre_crops(pictures, rays) for rays in (None, *stands)]
    before, same, after = (features for features, _ in seen)
    assert torch.equal(before, same) and not torch.allclose(before, after)


def overhead(x_m: float, y_m: float) -> torch.Tensor:
    """Rays of a camera 1 m above the table."""
    return DOWN + torch.nn.functional.pad(torch.tensor([x_m, y_m, 0.0])[:, None], (3, 0))


def test_two_rays_meet_at_whatever_height() -> None:
    """Of two cameras that see a point the height that is told hardly counts; of one it decides."""
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
    wrong = points[..., 2] + 0.02
    sure = torch.ones(50, 2, both.keypoints)
    assert (both.triangulate(rays, places, sure.flatten(1), wrong) - points).norm(dim=2).max() < 0.007
    sure[:, 1] = 1e-4  # it is not in the second picture
    alone = both.triangulate(rays, places, sure.flatten(1), wrong)
    expected = at_height(rays, places[:, : points.shape[1]], wrong)
    assert (alone - expected).norm(dim=2).max() < 0.002


def test_a_ray_that_never_comes_to_its_height_ends_somewhere() -> None:
    encoder = one_arm()
    level = torch.tensor([[0.0, 0.0, 1.0, 0.5], [1.0, 0.0, -0.5, 0.0], [0.0, -1.0, 0.5, 1.0]])[None, None]
    places = torch.full((1, 2 * len(GRIPPER_POINTS), 2), 0.5).requires_grad_()
    heights = torch.full((1, 2 * len(GRIPPER_POINTS)), 0.1)
    points = encoder.triangulate(level, places, torch.ones(1, 2), heights)
    points.sum().backward()
    assert places.grad is not None and torch.isfinite(places.grad).all() and points.abs().max() < 2
