"""Steps read back with rerun's own reader: poses, pictures, occupancy, predictions."""

import cv2
import numpy as np
import pyarrow as pa
import pytest

from rf_exp import viz
from rf_exp.transforms import transform
from rf_exp.types import CameraModel
from rf_exp.viz.layout import AGENT_COLOURS
from tests.viz.recorded import ACTION, BARRIER, CAMERAS, LINKS, PICTURE, POSES, QPOS, Content, open_recorder


def test_every_step_is_on_both_timelines(path):
    with open_recorder(path) as recorder:
        for step in range(5):
            moving = {viz.camera_entity("agent1"): transform((0, 0, 0.5 + 0.01 * step))}
            recorder.step(
                step,
                poses={**POSES, **moving},
                qpos=QPOS + 0.01 * step,
                action=ACTION,
                pictures={"global": PICTURE, "agent1": PICTURE},
            )
    content = Content(path)
    for entity in (*LINKS, BARRIER):
        assert len(content.column(f"/{entity}", "Mesh3D:triangle_indices")) == 1, entity
    for entity in (LINKS[0], BARRIER, viz.camera_entity("agent1")):
        steps = content.steps(f"/{entity}", "Transform3D:translation")
        assert sorted(steps) == [0, 1, 2, 3, 4], entity
        assert content.timelines[f"/{entity}"] == {"step", "time"}
    for camera in CAMERAS:
        assert len(content.column(f"/world/cameras/{camera}", "EncodedImage:blob")) == 5
    for agent in (1, 2):
        for curve in (f"/joints/agent{agent}/measured", f"/joints/agent{agent}/target"):
            assert [len(row) for row in content.column(curve, "Scalars:scalars")] == [7] * 5
        assert content.column(f"/gripper/agent{agent}/target", "Scalars:scalars") == [[0.0]] * 5
    np.testing.assert_allclose(content.column("/gripper/agent2/measured", "Scalars:scalars")[0], [80.0])
    times = [t for batch in content.batches[f"/{BARRIER}"] if "time" in batch.schema.names
             for t in batch.column("time").cast(pa.int64()).to_pylist()]  # fmt: skip
    assert sorted(times) == [50_000_000 * step for step in range(5)]  # ns at 20 Hz


def test_poses_and_pictures_are_read_as_written(path):
    with open_recorder(path) as recorder:
        recorder.step(0, poses=POSES, qpos=QPOS, pictures={"global": PICTURE})
    content = Content(path)
    [[translation]] = content.column(f"/{BARRIER}", "Transform3D:translation")
    [[columns]] = content.column(f"/{BARRIER}", "Transform3D:mat3x3")
    np.testing.assert_allclose(translation, POSES[BARRIER][:3, 3], atol=1e-6)
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, POSES[BARRIER][:3, :3], atol=1e-6)
    [[blob]] = content.column("/world/cameras/global", "EncodedImage:blob")
    picture = np.asarray(cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
    assert np.abs(picture.astype(int) - PICTURE).max() <= 6  # the order of channels is kept


def test_the_recorded_camera_matches_its_model(path):
    with open_recorder(path):
        pass
    [[intrinsics]] = Content(path).column("/world/cameras/global", "Pinhole:image_from_camera")
    image_from_camera = np.reshape(intrinsics, (3, 3)).T
    top = image_from_camera @ [0.0, -np.tan(np.deg2rad(35)), 1.0]  # half the vertical field of view upwards
    np.testing.assert_allclose(top[:2] / top[2], [16.0, 0.0], atol=1e-3)


def test_occupancy_has_the_colour_of_its_agent(path):
    centres = np.array([[0.025, 0.025, 0.025], [0.075, 0.025, 0.025]])
    with open_recorder(path) as recorder:
        recorder.occupancy("agent2", centres)
        recorder.occupancy("barrier", centres[:1], size_m=0.1)
        recorder.step(1, poses=POSES, qpos=QPOS)
        recorder.occupancy("agent2", None)
    content = Content(path)
    [boxes] = content.column("/world/occupancy/agent2", "Boxes3D:centers")
    np.testing.assert_allclose(boxes, centres)
    [[colour]] = content.column("/world/occupancy/agent2", "Boxes3D:colors")
    assert (colour >> 24, colour >> 16 & 255, colour >> 8 & 255) == AGENT_COLOURS[1]
    assert 0 < colour & 255 < 255  # translucent
    [[half]] = content.column("/world/occupancy/barrier", "Boxes3D:half_sizes")
    assert half == pytest.approx([0.05] * 3)
    assert content.steps("/world/occupancy/agent2", "Clear:is_recursive") == [1]


def test_predictions_are_at_future_steps(path):
    chunk = np.tile(ACTION[0], (3, 1)) + np.arange(3)[:, None] * 0.1
    with open_recorder(path, panels="rollout") as recorder:
        recorder.step(4, poses=POSES, qpos=QPOS)
        recorder.predicted_targets(1, 5, chunk)
        recorder.path(1, "predicted", np.zeros((3, 3)))
        recorder.note("now")
    content = Content(path)
    dots = "/joints/agent1/predicted"
    assert content.steps(dots, "Scalars:scalars") == [5, 6, 7]
    np.testing.assert_allclose(content.column(dots, "Scalars:scalars"), chunk[:, :7])
    opening = content.column("/gripper/agent1/predicted", "Scalars:scalars")
    np.testing.assert_allclose(opening, [[0.0], [4.0], [8.0]], atol=1e-9)  # mm, for -1, -0.9, -0.8
    assert content.steps("/log", "TextLog:text")[-1] == 4  # later entries are at the current step
    assert content.steps("/world/paths/agent1/predicted", "LineStrips3D:strips") == [4]


@pytest.mark.slow
def test_a_hundred_steps_with_three_pictures_stay_small(path):
    """With pictures that are hard to compress: blobs of 20 pixels in all colours."""
    rng = np.random.default_rng(0)
    noise = cv2.resize(rng.integers(0, 256, (12, 16, 3), dtype=np.uint8), (320, 240))
    cameras = {name: CameraModel(320, 240, 1.2, np.eye(4)) for name in ("global", "agent1", "agent2")}
    with open_recorder(path, cameras=cameras) as recorder:
        for step in range(100):
            pictures = {name: np.roll(noise, step, axis=1).astype(np.uint8) for name in cameras}
            recorder.step(step, poses=POSES, qpos=QPOS, action=ACTION, pictures=pictures)
    assert path.stat().st_size < 4e6  # raw pictures alone are 69 MB
