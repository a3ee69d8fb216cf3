"""Recordings, films and pictures that are requested and missing are made, also for a finished stage."""

import shutil
from dataclasses import replace

import cv2
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from rf_exp import processes
from rf_exp.ablation import EvaluationRow, append_row, read_rows
from rf_exp.errors import ArgumentError
from rf_exp.experiment import Experiment
from rf_exp.policy import train
from rf_exp.recording.film import HEIGHT_PX
from rf_exp.recording.recorders import PICTURES_EVERY
from rf_exp.stages import evaluate_policies, generate_data
from rf_exp.store import Store
from rf_exp.tasks import SuccessEvaluator
from rf_exp.types.choices import MIN_DISPLAY_PX
from rf_exp.viz.frames import GAP_PX, LINE_PX
from tests.conftest import cell_of, experiment
from tests.policy.conftest import HEIGHT, WIDTH, block_poses, make_episode
from tests.scenes import start_scene
from tests.viz.recorded import Content

STEPS = 6  # per rollout
SMALL = (
    *("arch=shared_local", "demos=1", "scenes=3", "workers=1", "wandb=disabled", "stages=[evaluate]"),
    *(
        "policy=paper",
        "policy.encoder.name=compact",
        "policy.head.diffusion.sampler=ddim",
        "policy.head.diffusion.inference_steps=4",
    ),
    *(
        "training.epochs=null",
        "training.steps=1",
        "training.batch_size=4",
        "policy.head.diffusion.channels=[16,32]",
    ),
    *(f"picture={{width: {WIDTH}, height: {HEIGHT}}}", f"task.lift_barrier.step_limit={STEPS}"),
)
RRD, MP4, PNG = ".rrd", ".mp4", ".png"


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Experiment:
    """A policy trained on one episode of another world, and evaluated in three scenes, where it fails."""
    small = replace(experiment(*SMALL, "recordings=0", "films=0"), out=tmp_path_factory.mktemp("out"))
    cell = cell_of(small)
    cameras, objects = ("global", "agent1", "agent2"), tuple(block_poses(0, 2))
    with Store.create(cell.data_path, {"task": "reach"}, 2, cameras, HEIGHT, WIDTH, objects) as store:
        store.append(make_episode(0, 2))
    for view in cell.views:
        folder = cell.policy_path / view.name
        train(Store.open(cell.data_path), view, small.policy, replace(small.training, seed=0), folder)
    evaluate(small)
    return small


def evaluate(given: Experiment, **changed) -> set[str]:
    """Runs the stage with other settings; the names of all recordings, films and pictures after it."""
    evaluate_policies(cell_of(replace(given, **changed)))
    folder = cell_of(given).recording_path("evaluate", 0).parent
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def name(seed: int, suffix: str) -> str:
    return f"evaluate-shared_local-test-1-{1_000_000 + seed}{suffix}"


@pytest.mark.render
@pytest.mark.slow
def test_recordings_of_a_finished_evaluation_are_made_and_kept(trained: Experiment) -> None:
    path = cell_of(trained).evaluation_path
    before = path.read_bytes()
    assert evaluate(trained) == set()
    assert evaluate(trained, recordings=2) == {name(0, RRD), name(1, RRD)}
    folder = trained.out / "recordings/lift_barrier/full"
    kept = (folder / name(0, RRD)).stat()
    (folder / name(1, RRD)).unlink()  # as after a crash
    assert evaluate(trained, recordings=(1_000_001, 1_000_002)) == {name(seed, RRD) for seed in range(3)}
    assert (folder / name(0, RRD)).stat() == kept
    assert path.read_bytes() == before  # repeated rollouts add no rows


@pytest.mark.render
@pytest.mark.slow
def test_films_of_a_finished_evaluation_are_made_and_bounded(trained: Experiment) -> None:
    made = {each for each in evaluate(trained, films=1) if not each.endswith(RRD)}
    assert made == {name(0, MP4), name(0, PNG)}  # one failure; there is no success
    folder = trained.out / "recordings/lift_barrier/full"
    frames = imageio_ffmpeg.read_frames(str(folder / name(0, MP4)))
    assert next(frames)["codec"] == "h264"
    shown = [np.frombuffer(frame, np.uint8) for frame in frames]
    with Image.open(folder / name(0, PNG)) as picture:
        last = np.asarray(picture).ravel()
    assert last.size == shown[-1].size and np.abs(last.astype(int) - shown[-1]).mean() < 10
    assert (folder / name(0, MP4)).stat().st_size < 200_000
    (folder / name(0, PNG)).unlink()
    assert {each for each in evaluate(trained, films=1) if not each.endswith(RRD)} == made


@pytest.mark.render
@pytest.mark.slow
def test_a_recorded_rollout_shows_what_was_predicted_done_and_judged(trained: Experiment) -> None:
    """It ends as its row says."""
    evaluate(trained, recordings=(1_000_000,))
    content = Content(trained.out / "recordings/lift_barrier/full" / name(0, RRD))
    path = cell_of(trained).evaluation_path
    row = read_rows(path, EvaluationRow)[0]
    steps = list(range(1, STEPS + 1))
    for agent in (1, 2):
        measured = content.steps(f"/joints/agent{agent}/measured", "Scalars:scalars")
        assert sorted(measured) == [0, *steps]
        for kind in ("target", "predicted"):
            assert sorted(content.steps(f"/joints/agent{agent}/{kind}", "Scalars:scalars")) == steps
        assert content.column(f"/world/paths/agent{agent}/predicted", "LineStrips3D:strips")
        assert len(content.column(f"/world/paths/agent{agent}/done", "LineStrips3D:strips")) == STEPS
    distances = content.column("/arms/distances/agents\\ 1\\ and\\ 2", "Scalars:scalars")
    assert len(distances) == 1 + STEPS // 2 and all(0 < cm < 200 for [cm] in distances)
    lane = "/conditions/lifted"
    assert content.column(lane, "StateChange:state") == [["not yet"]]
    [verdict] = content.column("/verdict", "TextDocument:text")[-1]
    assert f"**Failed after {STEPS * 0.05:.2f} s**" in verdict and row.reason.split("; ")[0] in verdict
    assert "| **not yet** | lifted | " in verdict and "> 0.15" in verdict
    pictures = content.column("/world/cameras/global", "EncodedImage:blob")
    assert len(pictures) == 1 + STEPS // PICTURES_EVERY
    [blob] = pictures[-1]
    picture = cv2.imdecode(np.asarray(blob, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape[0] == MIN_DISPLAY_PX > HEIGHT  # of the policy's pictures


@pytest.mark.render
@pytest.mark.slow
def test_a_rollout_that_ends_otherwise_than_its_row_is_reported(
    trained: Experiment, tmp_path, capsys
) -> None:
    other = replace(trained, out=tmp_path / "out")
    shutil.copytree(trained.out, other.out, ignore=shutil.ignore_patterns("recordings"))
    path = cell_of(other).evaluation_path
    row = read_rows(path, EvaluationRow)[-1]
    append_row(path, replace(row, steps=STEPS - 1))
    evaluate(other, recordings=(row.scene_seed,))
    output = " ".join(capsys.readouterr().out.split())
    assert f"warning: scene {row.scene_seed} ended otherwise than in its row: success False after 6" in output


@pytest.mark.render
@pytest.mark.slow
def test_a_shielded_evaluation_is_kept_apart(trained: Experiment, tmp_path) -> None:
    """With rows, recordings and films of its own, which show the shield; one process makes all of them."""
    shielded = replace(trained, shield=True, out=tmp_path / "out")
    shutil.copytree(trained.out, shielded.out, ignore=shutil.ignore_patterns("recordings"))
    task, plain = shielded.tasks[0], cell_of(replace(shielded, shield=False)).evaluation_path
    before = plain.read_bytes()
    shown = "evaluate-shared_local-test-1-shield-1000000"
    assert evaluate(shielded, recordings=1, films=1) == {f"{shown}{suffix}" for suffix in (RRD, MP4, PNG)}
    assert len(processes._idle) == 1  # the process of the rows also made the rest
    path = cell_of(shielded).evaluation_path
    assert path.name == "full-test-1-shield.jsonl" and plain.read_bytes() == before
    assert [(each.shield, each.steps) for each in read_rows(path, EvaluationRow)] == [(True, STEPS)] * 3
    folder = cell_of(shielded).recording_path("evaluate", 0).parent
    assert Content(folder / f"{shown}{RRD}").column("/conditions/shield", "StateChange:state")[0] == ["holds"]
    with Image.open(folder / f"{shown}{PNG}") as picture:
        lines = len(SuccessEvaluator(task, start_scene(task, 0))(start_scene(task, 0)).evidence) + 1
        assert 0 <= picture.height - (HEIGHT_PX + LINE_PX * lines + 3 * GAP_PX) <= 1  # one more line


@pytest.mark.slow
def test_recordings_of_a_finished_generation_are_made(tmp_path) -> None:
    """Of the first demonstrations or of given seeds, also of a failed one, to see why it failed."""
    small = replace(
        experiment("stages=[generate]", "render=false", "demos=1", "workers=1", "recordings=0"), out=tmp_path
    )
    folder = cell_of(small).recording_path("generate", 0).parent
    generate_data(cell_of(small))
    assert not list(folder.glob("*.rrd"))
    path = cell_of(small).generation_path
    before = path.read_bytes()
    generate_data(cell_of(replace(small, recordings=2)))
    first, second = (f"generate-{cell_of(small).data_path.stem}-{seed}.rrd" for seed in (0, 1))
    assert [each.name for each in folder.glob("*.rrd")] == [first]
    generate_data(cell_of(replace(small, recordings=(1,))))
    assert {each.name for each in folder.glob("*.rrd")} == {first, second}
    assert path.read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["recordings=-1"], "recordings is -1; it must be at least 0"),
        (["recordings=[3,-1]"], "recordings names seed -1"),
        (["recordings=[1000000]", "stages=[generate]"], "from 1000000 on, by evaluate; stages is"),
        (["recordings=[3]", "stages=[evaluate]"], "from 0 on, recorded by stage generate"),
        (["films=-1"], "films is -1; it must be at least 0"),
    ],
)
def test_recordings_that_no_stage_would_make_are_refused(arguments: list[str], message: str) -> None:
    with pytest.raises(ArgumentError, match=message.replace("[", "\\[")):
        experiment(*arguments)


def test_recordings_are_a_number_or_seeds() -> None:
    numbered, named = experiment("recordings=2"), experiment("recordings=[1000003,5,1000007]")
    assert numbered.recorded("generate", [4, 6, 9]) == (4, 6)
    assert named.recorded("generate", [4, 6, 9]) == (5,)
    assert named.recorded("evaluate", range(1_000_000, 1_000_002)) == (1_000_003, 1_000_007)
