"""The gallery: rendered episodes, captions that match the step they are under, and playable films."""

import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra
from PIL import Image

from rf_exp.command import run_guarded
from rf_exp.datagen import Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import StageError
from rf_exp.gallery import perform, replay, sheets
from rf_exp.gallery.__main__ import main
from rf_exp.gallery.draw import FRAME_STEPS, REST_FRAMES
from rf_exp.sim import Simulator
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet


@pytest.fixture
def command(monkeypatch, capsys):
    """The command in this process, with small pictures: exit code, standard output, standard error."""
    monkeypatch.setattr(sheets, "WIDTH_PX", 160)
    monkeypatch.setattr(sheets, "HEIGHT_PX", 120)
    monkeypatch.setattr(sheets, "TRIES", 2)

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp.gallery", *arguments])
        GlobalHydra.instance().clear()
        capsys.readouterr()
        code = run_guarded(main)
        return subprocess.CompletedProcess(arguments, code, *capsys.readouterr())

    return call


@pytest.mark.render
@pytest.mark.slow
def test_every_task_gets_a_sheet_and_a_film_beside_a_common_sheet(command, tmp_path: Path) -> None:
    result = command("task=[pick_meat,lift_barrier]", "seed=3", f"out={tmp_path}")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "pick_meat: seed 3, " in result.stdout and "lift_barrier: seed 3, " in result.stdout
    folder = tmp_path / "gallery"
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "gallery.png",
        *(f"{t}.{s}" for t in ("pick_meat", "lift_barrier") for s in ("png", "jpg", "mp4")),
    }
    narrow, wide = (np.asarray(Image.open(folder / f"{t}.png")) for t in ("pick_meat", "lift_barrier"))
    assert wide.shape[1] > narrow.shape[1]  # a column for each camera
    overview = Image.open(folder / "gallery.png")
    assert overview.width > 900 and np.asarray(overview).std() > 20
    assert Image.open(folder / "pick_meat.jpg").width > 1400  # three moments side by side
    frames, size, rate, codec = film_of(folder / "lift_barrier.mp4")
    assert (rate, codec) == (20, "h264") and size[0] % 2 == size[1] % 2 == 0
    seconds = float(result.stdout.split("lift_barrier: seed 3, ")[1].split(" s")[0])
    assert frames == pytest.approx(seconds * 20 / FRAME_STEPS + REST_FRAMES, abs=1)


def film_of(path: Path) -> tuple[int, tuple[int, int], float, str]:
    """Frames that can be decoded, size in pixels, frames a second, codec."""
    reader = imageio_ffmpeg.read_frames(str(path), pix_fmt="rgb24")
    metadata = next(reader)
    assert isinstance(metadata, dict) and metadata["pix_fmt"].startswith("yuv420p")  # supported by browsers
    pictures = [np.frombuffer(data, np.uint8) for data in reader]
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 100
    return len(pictures), metadata["source_size"], metadata["fps"], metadata["codec"]


@pytest.mark.render
@pytest.mark.slow
def test_the_gallery_shows_the_other_tasks_if_one_fails(command, tmp_path: Path) -> None:
    result = command(
        "task=[lift_barrier,pick_meat]", "task.lift_barrier.success.lift_m=0.9", f"out={tmp_path}"
    )
    assert result.returncode == 1
    assert (
        result.stderr.strip().splitlines()[-1]
        == "failed: no episode to show of lift_barrier; the reasons are above"
    )
    assert "lift_barrier: none of the 2 seeds from 0 on succeeded, the last: failed: " in result.stdout
    assert {path.name for path in (tmp_path / "gallery").iterdir()} == {
        *("gallery.png", "pick_meat.png", "pick_meat.jpg", "pick_meat.mp4")
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("render=false", "render=false makes no pictures, and the gallery is pictures"),
        ("constraints=all", "the gallery shows one of them, e.g. constraints=full"),
        ("task=juggle", "lift_barrier"),
    ],
)
def test_wrong_arguments_exit_with_2(command, argument: str, message: str, tmp_path: Path) -> None:
    result = command(argument, "stages=[generate]", f"out={tmp_path}")
    assert result.returncode == 2 and message in result.stderr
    assert not (tmp_path / "gallery").exists()


@pytest.mark.render
@pytest.mark.slow
def test_captions_match_their_step(place_food: Task) -> None:
    with Simulator(place_food, width_px=64, height_px=48) as world:
        performance, _ = perform(
            Settings.configured(place_food, ConstraintSet("full"), ScriptedSpec()), world, 0
        )
        assert performance is not None
        start, middle, end = performance.stills
        assert [still.title for still in performance.stills] == ["start", "middle", "end"]
        assert (start.time_s, end.time_s) == (0.0, performance.seconds)
        assert [line.text for line in start.activities] == ["grasp steak at center", "grasp lid at knob"]
        assert not any(line.moving for line in end.activities)
        assert 0.25 <= middle.time_s / performance.seconds <= 0.75
        texts = [line[1].text for line in performance.activities]
        assert list(dict.fromkeys(texts))[:3] == [
            "grasp lid at knob",
            "lift lid by 0.12 m",
            "place lid to aside",
        ]
        # Arms captioned as waiting do not move, others do.
        moved = np.abs(np.diff(performance.actions[:, :, :7], axis=0)).max(axis=2)  # (T - 1, N)
        moving = np.array([[line.moving for line in lines] for lines in performance.activities])[1:]
        assert moved[~moving].max() < 1e-9
        assert (moved[moving] > 1e-6).mean() > 0.7  # the rest closes or opens the gripper
        left, top, right, bottom = performance.crop  # in the picture, with its aspect ratio
        assert 0 <= left < right <= 64 and 0 <= top < bottom <= 48
        assert (right - left) / (bottom - top) == pytest.approx(64 / 48) and right - left < 64
        # The stills differ mostly in the objects that were moved.
        assert np.abs(start.pictures["global"].astype(int) - end.pictures["global"]).max() > 50
        with pytest.raises(
            StageError, match="'place_food', seed 1: played again, the episode does not succeed"
        ):
            list(replay(world, 1, performance.actions, set()))
