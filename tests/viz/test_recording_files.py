"""Files of recordings and films: complete after any error, and invalid arguments refused."""

import numpy as np
import pytest

from rf_exp import viz
from rf_exp.errors import ArgumentError, StageError
from rf_exp.viz import Film
from tests.children import small_files
from tests.viz.recorded import BARRIER, BLOCKED, PICTURE, POSES, QPOS, Content, open_recorder


def test_an_unwritable_film_is_reported(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with (
        pytest.raises(StageError, match=r"cannot write the film .*x\.mp4"),
        Film(tmp_path / "file/x.mp4") as film,
    ):
        for _ in range(100):
            film.add(np.zeros((240, 320, 3), np.uint8))


def test_a_film_truncated_by_a_full_disk_is_refused(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (40, 48, 64, 3), np.uint8)
    with (
        small_files(100_000),
        pytest.raises(
            StageError, match=r"cannot write the film .*x\.mp4: (it has \d+ of 40 frames; make|.*pipe)"
        ),
        Film(tmp_path / "x.mp4", quality=None) as film,
    ):
        for frame in noise:
            film.add(frame)


def test_the_file_is_complete_after_an_exception(path):
    with pytest.raises(RuntimeError, match="arm lost"), open_recorder(path) as recorder:
        recorder.step(4, poses=POSES, qpos=QPOS)
        raise RuntimeError("arm lost")
    content = Content(path)
    assert content.steps(f"/{BARRIER}", "Transform3D:translation") == [4]
    assert content.texts("/log") == ["lift barrier, full, seed 7", "ended by RuntimeError: arm lost"]
    content.reader.store()  # fails without the footer, which is written last


def test_concurrent_recordings_are_separate(path, tmp_path):
    other_path = tmp_path / "other.rrd"
    with open_recorder(path) as recorder, open_recorder(other_path) as other:
        recorder.step(1, poses=POSES, qpos=QPOS)
        other.step(2, poses=POSES, qpos=QPOS)
        recorder.note("first")
    first, second = Content(path), Content(other_path)
    assert first.steps("/log", "TextLog:text") == [0, 1]
    assert second.steps(f"/{BARRIER}", "Transform3D:translation") == [2]
    identifiers = {reader.recordings()[0].recording_id for reader in (first.reader, second.reader)}
    assert len(identifiers) == 2


def test_recording_after_close_is_an_error(path):
    recorder = open_recorder(path)
    recorder.close()
    recorder.close()
    with pytest.raises(StageError, match=r"generate-7\.rrd is closed; nothing more can be recorded"):
        recorder.note("too late")


INVALID = {
    "pose shape": (
        {"poses": {BARRIER: np.eye(3)}},
        "poses['world/objects/barrier'] has shape 3x3; expected 4x4",
    ),
    "pose value": (
        {"poses": {BARRIER: np.full((4, 4), np.nan)}},
        "poses['world/objects/barrier'] holds nan; expected finite numbers",
    ),
    "pose name": (
        {"poses": {"world/objects/barier": np.eye(4)}},
        "unknown entity in poses 'world/objects/barier'; available: world/agent1/panda_hand, ",
    ),
    "fixed camera": (
        {"poses": {"world/cameras/global": np.eye(4)}},
        "unknown entity in poses 'world/cameras/global'; available: world/agent1/panda_hand, ",
    ),
    "qpos": ({"qpos": QPOS[:1]}, "qpos has shape 1x9; expected 2x9"),
    "action": ({"action": QPOS}, "action has shape 2x9; expected 2x8"),
    "picture size": (
        {"pictures": {"global": PICTURE[:, :16]}},
        "pictures['global'] has shape 24x16x3; expected 24x32x3",
    ),
    "picture type": (
        {"pictures": {"global": PICTURE / 255.0}},
        "pictures['global'] is float64; expected uint8",
    ),
    "picture name": (
        {"pictures": {"agent2": PICTURE}},
        "unknown camera in pictures 'agent2'; available: agent1, global",
    ),
}


@pytest.mark.parametrize("overrides, message", INVALID.values(), ids=INVALID)
def test_an_invalid_argument_of_a_step_is_named(path, overrides, message):
    with open_recorder(path) as recorder, pytest.raises(ArgumentError) as error:
        recorder.step(0, **{"poses": POSES, "qpos": QPOS, **overrides})
    assert message in str(error.value)


def test_other_invalid_values_are_named(path):
    with open_recorder(path) as recorder:
        recorder.step(5, poses=POSES, qpos=QPOS)
        with pytest.raises(ArgumentError, match="step 4 comes after step 5; steps do not go back"):
            recorder.step(4, poses=POSES, qpos=QPOS)
        with pytest.raises(ArgumentError, match="unknown agent 'agent3'; available: agent1, agent2"):
            recorder.occupancy("agent3", np.zeros((1, 3)))
        with pytest.raises(ArgumentError, match="centres_m of agent1 has shape 4x2; expected 4x3"):
            recorder.occupancy("agent1", np.zeros((4, 2)))
        with pytest.raises(ArgumentError, match="places_m has shape 1x2; expected 1x3"):
            recorder.violation(BLOCKED, [(0.0, 1.0)])
        with pytest.raises(ArgumentError, match="unknown agent 'agent0'; available: agent1, agent2"):
            recorder.motion(0, "home", "move")


def test_invalid_recordings_are_refused_with_the_reason(path, tmp_path):
    with pytest.raises(ArgumentError, match=r"generate-7\.mp4: the viewer opens only .* \.rrd"):
        open_recorder(path.with_suffix(".mp4"))
    with pytest.raises(ArgumentError, match="recording of 0 agents; expected at least 1"):
        open_recorder(path, agents=0)
    with pytest.raises(ArgumentError, match="unknown moving camera 'agent9'; available: agent1, global"):
        open_recorder(path, moving=["agent9"])
    bad = viz.Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), colour=np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="colour of 'world/objects/bad' has shape 2x3; expected 3 or 3x3"):
        open_recorder(path, meshes={viz.object_entity("bad"): bad})
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StageError, match=r"cannot write the recording .*file/x\.rrd: "):
        open_recorder(tmp_path / "file" / "x.rrd")
