"""Pictures of every task: reproducible, different for each seed, and consistent with the camera models."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from mani_skill.agents.robots.panda import Panda as StockPanda

from rf_exp.laws import LAWS, Law
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim import Simulator, robots
from rf_exp.sim.objects import FLOOR_Z_M
from rf_exp.tasks import TABLE_CENTRE_M, CameraSpec, Task
from rf_exp.transforms import apply, inverse
from tests.conftest import TASKS, read_task
from tests.sim.test_simulator import digest, digest_in_other_process, random_walk

pytestmark = pytest.mark.render
TOP_M = 1.2  # the table covers this half-width around its centre; beyond are floor and walls
MEAN_LEVELS, SHARE_OF_PIXELS = (
    1.3,
    0.01,
)  # mean difference of 255; share of pixels that differ by more than 40


@pytest.fixture(scope="module", params=TASKS)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(read_task(request.param)) as simulator:
        yield simulator


def test_every_camera_gives_a_picture(simulator: Simulator) -> None:
    simulator.reset(0)
    pictures = simulator.images()
    assert tuple(pictures) == simulator.cameras == tuple(simulator.task.cameras)
    for picture in pictures.values():
        assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8


@pytest.mark.slow
@pytest.mark.parametrize("law", [law for law in LAWS if law.pictures], ids=str)
def test_law(simulator: Simulator, law: Law) -> None:
    assert not list(law.violations(simulator)), law.sentence


@pytest.mark.slow
def test_the_same_seed_gives_the_same_pictures_whatever_ran_before(simulator: Simulator) -> None:
    first = digest(simulator, random_walk(simulator, 5))
    other = digest(simulator, random_walk(simulator, 6))
    again = digest(simulator, random_walk(simulator, 5))
    assert first == again == digest_in_other_process(simulator.task, 5, render=True)
    assert first != other


@pytest.mark.slow
def test_other_seeds_give_other_pictures(simulator: Simulator) -> None:
    distinct = set()
    for seed in range(5):
        simulator.reset(seed)
        distinct |= {picture.tobytes() for picture in simulator.images().values()}
    assert len(distinct) == 5 * len(simulator.cameras)


def test_camera_models_agree_with_the_pictures(simulator: Simulator) -> None:
    simulator.reset(2)
    depths, images, bodies = simulator.depth(), simulator.segmentation(), simulator.bodies()
    for name, model in simulator.camera_models().items():
        rows, columns = np.nonzero(np.isin(images[name], bodies["table"]))
        depth = depths[name][rows, columns].astype(float)
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
        rays = np.linalg.inv(model.intrinsics) @ pixels  # depth 1
        points = apply(model.world_from_camera, (rays * depth).T)
        # A camera beside the table sees the floor below its edge.
        floor = np.abs(points[:, 2] - FLOOR_Z_M) < 0.01
        top = (np.abs(points[:, :2] - TABLE_CENTRE_M).max(axis=1) < TOP_M) & ~floor
        height = points[top, 2]
        assert len(height) > 1000
        assert np.abs(np.median(height)) < 2e-3 and np.quantile(np.abs(height), 0.95) < 5e-3, name


def test_a_wrist_camera_moves_with_its_gripper(lift_barrier: Task) -> None:
    cameras = {**lift_barrier.cameras, "agent1": CameraSpec(fov_deg=75, mount="wrist")}
    with Simulator(replace(lift_barrier, cameras=cameras)) as simulator:
        start = simulator.reset(0)
        before, picture = simulator.camera_models(), simulator.images()["agent1"]
        fingers = simulator.segmentation()["agent1"]
        assert np.isin(fingers, simulator.bodies()["agent1"]).sum() > 500
        tcp = Arm(DEFAULT, lift_barrier.robots[0].world_from_base).tcp(start.qpos[0])
        point = apply(inverse(before["agent1"].world_from_camera), tcp[:3, 3])
        column, row, _ = before["agent1"].intrinsics @ point / point[2]
        assert 60 < column < 260 and 40 < row < 200  # the finger tips are inside the picture
        action = simulator.command
        action[0, 0] += 0.3
        for _ in range(15):
            simulator.step(action)
        after = simulator.camera_models()
        change = np.abs(simulator.images()["agent1"].astype(int) - picture).mean()
    assert change > 5
    rotation = before["agent1"].world_from_camera[:3, :3].T @ after["agent1"].world_from_camera[:3, :3]
    assert np.arccos((np.trace(rotation) - 1) / 2) == pytest.approx(0.3, abs=5e-3)
    np.testing.assert_array_equal(before["global"].world_from_camera, after["global"].world_from_camera)


def test_camera_axes_are_right_down_forward() -> None:
    pose = CameraSpec((1.0, 0.0, 1.0), (0.0, 0.0, 1.0)).world_from_camera
    np.testing.assert_allclose(pose[:3, :3], [[0, 0, -1], [1, 0, 0], [0, -1, 0]], atol=1e-12)
    straight_down = CameraSpec((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)).world_from_camera
    np.testing.assert_allclose(straight_down[:3, 2], [0, 0, -1], atol=1e-12)
    assert DEFAULT.hand.from_camera[2, 2] > 0  # along the fingers


def test_simplified_meshes_look_like_the_full_ones(
    lift_barrier: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = []
    for urdf in (robots.simplified_urdf(DEFAULT), StockPanda.urdf_path):
        monkeypatch.setattr(robots, "simplified_urdf", lambda robot, urdf=urdf: urdf)
        with Simulator(lift_barrier) as simulator:
            simulator.reset(0)
            pictures.append(simulator.images())
    simplified, full = pictures
    for camera in simplified:
        difference = np.abs(simplified[camera].astype(int) - full[camera])
        assert difference.any(), "both pictures show the same meshes"
        assert difference.mean() < MEAN_LEVELS, camera
        assert (difference.max(axis=-1) > 40).mean() < SHARE_OF_PIXELS, camera
