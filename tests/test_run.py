"""The main command line: exit codes, messages, skipping, resuming, parallel workers."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rf_exp.store import Store
from tests.offline_runs import runs

ROOT = Path(__file__).parents[1]

TINY = (
    "episodes=2",  # none fails; otherwise a third one would start, in a process that is then ended
    "demos=2",
    "scenes=2",
    "recordings=1",
    "films=1",
    "train_seed=7",
    "workers=1",
    "wandb=offline",
    "picture={width: 64, height: 48}",
    "task.lift_barrier.step_limit=20",  # policies with little training use all steps
    "training.steps=3",
    "policy.encoder.keypoints.steps=2",
    "policy.head.refined.regression_steps=2",
    "training.batch_size=8",
)


def run(*arguments, environment=None, timeout_s=600):
    """The command in a separate process."""
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.run", *arguments],
        cwd=ROOT,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["task=juggle"], "lift_barrier"),
        (["arch=monolith"], "separate_local"),
        (["constraints=none_at_all"], "logical_spatial"),
        (["brain=oracle"], "scripted"),
        (["stages=[bake]"], "unknown stage 'bake'; available: generate, train, evaluate, report"),
        (["stages=generate"], "stages is 'generate'; expected a list: stages=[...]"),
        (
            ["policy.head.diffusion.channels=32"],
            "policy.head.diffusion.channels is 32; expected a list: policy.head.diffusion.channels=[...]",
        ),
        (["demos=-3"], "demos is -3; it must be at least 1"),
        (["attempts=0"], "attempts is 0; it must be at least 1"),
        (["training.steps=-5"], "steps is -5; expected a number above 0"),
        (["scenes=0"], "scenes is 0; it must be at least 1"),
        (["first_scene=7"], "first_scene is 7; seeds of evaluation begin with 1000000"),
        (["limits.velocity_rad_s=-1"], "velocity_rad_s is -1"),
        (["seed_limit_s=0"], "seed_limit_s is 0.0; it must be at least 1"),
        (["name=../../../x"], "name is '../../../x'; expected a name for a file: letters, digits"),
        (["name=.."], "name is '..'; expected a name for a file"),
        (["name=''"], "name is ''; expected a name for a file"),
        (["+constraints={../../x: {}}"], "constraints is '../../x'"),
        (["picture={width: 100000, height: 100000}"], "picture.width is 100000; possible are 16 to 2048"),
        (["picture.height=0"], "picture.height is 0; possible are 16 to 2048 pixels"),
        (["seed=1000000"], "generation must stay below 1000000"),
        (["render=false"], "render=false makes no pictures to learn from"),
        (["stages=[generate]", "render=false", "occupancy=depth"], "render=true or occupancy=state"),
        (
            ["stages=[generate]", "render=false", "store.depth=true"],
            "store.depth=true is seen by the cameras",
        ),
        (["occupancy=guess"], "unknown occupancy 'guess'; available: depth, state"),
        (["task.lift_barrier.objects.barrier.x_m=[0.2,-0.2]"], "the wrong way round; write [-0.2, 0.2]"),
        (["task.lift_barrier.objects.barrier.asset=lamp"], "unknown asset 'lamp'; available: barrier"),
        (
            ["episodes=3", "demos=5", "stages=[generate]"],
            "episodes=3 demos=5: episodes already says how much",
        ),
        (["episodes=3", "demos=5"], "episodes=3 demos=5: 3 seeds cannot give 5 demonstrations"),
        (["experiment=ablation", "demos=5"], "episodes=1000 demos=5: episodes already says"),
        (["demoz=3"], "there is no key 'demoz'; did you mean demos? The keys are in conf/config.yaml and"),
        (["policy.acting.deadband_rads=0.1"], "did you mean policy.acting.deadband_rad?"),
        (
            ["task.lift_barrier.objects.barier.x_m=[0,0]"],
            "did you mean task.lift_barrier.objects.barrier.x_m?",
        ),
        (["workers=many"], "workers"),
        (
            ["arch=shared_global", "cameras=local"],
            "arch=shared_global looks through global, and cameras=local makes no pictures of it",
        ),
    ],
)
def test_wrong_arguments_exit_with_2_and_list_valid_ones(command, arguments, message, tmp_path):
    result = command(*arguments, f"out={tmp_path / 'out'}")
    assert result.returncode == 2, result.stdout + result.stderr
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.glob("out/data/*")), "no work before arguments are checked"


def test_output_below_a_file_cannot_be_written(command, tmp_path):
    (tmp_path / "file").write_text("in the way")
    result = command(
        "stages=[generate]",
        "render=false",
        "demos=1",
        f"out={tmp_path / 'file' / 'out'}",
        "hydra.run.dir=" + str(tmp_path),
    )
    assert result.returncode == 2
    assert "cannot write below" in result.stderr and "out=FOLDER" in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stages", "blocked"),
    [
        ("generate", "recordings"),
        ("generate", "recordings/lift_barrier/full"),
        ("generate", "data/lift_barrier"),
        ("generate", "results"),
        ("train", "wandb"),
        ("train", "policies/lift_barrier/full/separate_local/fast-50-0"),
        ("evaluate", "recordings"),
        ("evaluate", "results/evaluate/lift_barrier"),
        ("report", "tables"),
    ],
)
def test_a_file_in_place_of_a_folder_is_reported_before_any_work(command, tmp_path, stages, blocked):
    (tmp_path / blocked).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / blocked).write_text("in the way")
    result = command(f"stages=[{stages}]", f"out={tmp_path}")
    assert result.returncode == 2, result.stderr
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith(f"wrong argument: cannot write below {tmp_path / blocked.split('/')[0]}")
    assert "out=FOLDER" in last and "Traceback" not in result.stderr
    assert not list(tmp_path.glob("data/*/*/*")), "no work before"


def test_training_without_data_names_the_missing_stage(command, tmp_path):
    result = command("stages=[train]", f"out={tmp_path}")
    assert result.returncode == 1
    assert "run stages=[generate] first" in result.stderr.strip().splitlines()[-1]


@pytest.mark.slow
def test_rendering_without_vulkan_fails_before_any_work(tmp_path):
    environment = {"VK_DRIVER_FILES": "/nonexistent.json", "VK_ICD_FILENAMES": "/nonexistent.json"}
    result = run("stages=[generate]", "demos=1", "workers=1", f"out={tmp_path}", environment=environment)
    assert result.returncode == 1
    assert "Vulkan" in result.stderr and "render=false" in result.stderr
    assert not list(tmp_path.glob("results/generate/*/*.jsonl"))


PAIR = ("lift_barrier", "pick_meat")


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    """Two demonstrations of each of two tasks, without pictures, generated by one process."""
    out = tmp_path_factory.mktemp("generated")
    arguments = ["stages=[generate]", f"task=[{','.join(PAIR)}]", "render=false", "episodes=2"]
    arguments += ["recordings=0", "workers=1"]
    result = run(*arguments, f"out={out}")
    assert result.returncode == 0, result.stderr
    return out, arguments


@pytest.mark.slow
def test_every_seed_is_a_row(generated):
    out, _ = generated
    for task in PAIR:
        rows = [
            json.loads(line)
            for line in (out / f"results/generate/{task}/full-disturbed.jsonl").read_text().splitlines()
        ]
        assert [row["seed"] for row in rows] == [0, 1]
        assert all(row["success"] and row["reason"] == "" for row in rows)


@pytest.mark.slow
def test_finished_work_is_skipped(command, generated):
    out, arguments = generated
    files = [path for path in (out / "data").rglob("*") if path.is_file() and path.suffix != ".lock"]
    before = {path: path.stat().st_mtime_ns for path in files}
    result = command(*arguments, f"out={out}")
    assert result.returncode == 0
    assert result.stdout.count("nothing to do") == 2
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
def test_two_workers_make_the_same_bytes_as_one(command, generated, tmp_path):
    out, arguments = generated
    result = command(*arguments[:-1], "workers=2", f"out={tmp_path}")
    assert result.returncode == 0, result.stderr
    for task in PAIR:
        first, second = (Store.open(folder / f"data/{task}/full/fast.zarr") for folder in (out, tmp_path))
        assert first.digest() == second.digest()


@pytest.mark.slow
def test_a_run_without_a_success_fails(command, tmp_path):
    arguments = ["task=pick_meat", "brain=faulty", "brain.fault=missing_object", "attempts=1"]
    arguments += ["render=false", "episodes=2", "workers=1"]
    result = command(*arguments, "stages=[generate,report]", f"out={tmp_path}")
    assert result.returncode == 1
    assert result.stderr.strip().splitlines()[-1] == (
        "failed: no seed succeeded: 2 of 2: nothing was carried out; unknown object; the rows are in "
        f"{tmp_path}/results/generate/pick_meat/full-disturbed-by-faulty+missing_object.jsonl"
    )
    assert (tmp_path / "report.html").exists(), "the attempts are told all the same"


@pytest.mark.slow
def test_a_changed_configuration_is_not_reused(command, generated):
    out, arguments = generated
    result = command(*arguments, "limits.velocity_rad_s=0.5", f"out={out}")
    assert result.returncode == 1
    assert "limits" in result.stderr and "0.9" in result.stderr and "0.5" in result.stderr
    assert "out=FOLDER" in result.stderr


@pytest.mark.slow
def test_more_episodes_continue_where_fewer_stopped(command, generated, tmp_path):
    out, _ = generated
    for episodes in (1, 2):
        arguments = ("stages=[generate]", "render=false", f"episodes={episodes}", "recordings=0", "workers=1")
        result = command(*arguments, f"out={tmp_path}")
        assert result.returncode == 0, result.stderr
    resumed, at_once = (Store.open(folder / "data/lift_barrier/full/fast.zarr") for folder in (tmp_path, out))
    assert resumed.digest() == at_once.digest()


ARCHS = ("shared_global", "shared_local", "separate_global", "separate_local")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A tiny experiment with all stages: output folder, arguments, result of the command."""
    out = tmp_path_factory.mktemp("tiny")
    arguments = (*TINY, "arch=all", f"out={out}")
    return out, arguments, run(*arguments)


@pytest.mark.render
@pytest.mark.slow
def test_the_whole_experiment_at_a_tiny_size(command, tiny):
    out, arguments, result = tiny
    assert result.returncode == 0, result.stdout + result.stderr
    assert "report:" in result.stdout and "rerun " in result.stdout
    assert "film: " in result.stdout and "scenes succeeded (95 % interval" in result.stdout
    assert "next: python -m rf_exp.run task=two_robots_stack_cube" in result.stdout
    for arch in ARCHS:
        policies = list((out / "policies/lift_barrier/full" / arch / "fast-2-7").glob("*/model.safetensors"))
        assert len(policies) == (1 if arch.startswith("shared") else 2)
        lines = (out / f"results/evaluate/lift_barrier/{arch}/full-fast-2.jsonl").read_text().splitlines()
        assert [json.loads(line)["scene_seed"] for line in lines] == [1_000_000, 1_000_001]
        recording = f"recordings/lift_barrier/full/evaluate-{arch}-fast-2-t7-1000000"
        assert (out / f"{recording}.rrd").stat().st_size > 50_000
        assert (out / f"{recording}.mp4").exists()
        assert f'src="{recording}.mp4"' in (out / "report.html").read_text()
    assert (out / "recordings/lift_barrier/full/generate-fast-0.rrd").stat().st_size > 50_000
    assert (out / "report.html").stat().st_size > 10_000
    for name in ("tasks", "comparison", "benchmark", "architectures", "ablation_success", "ablation_length"):
        assert {path.suffix for path in (out / "tables").glob(f"{name}.*")} == {".md", ".csv", ".tex"}
    again = command(*arguments)
    assert again.returncode == 0 and "nothing to do" in again.stdout


@pytest.mark.render
@pytest.mark.slow
def test_training_and_evaluation_log_their_metadata(tiny):
    """In their runs of Weights & Biases, which is not mentioned on the terminal."""
    out, _, result = tiny
    assert "wandb" not in (result.stdout + result.stderr).lower()
    logged, suffix = runs(out), "fast, 2 demos, train seed 7"
    assert "generate lift_barrier/full, 2 episodes, seed 0" in logged
    for arch in ARCHS:
        cell = f"lift_barrier/full/{arch}"
        of_cell = {name: log for name, log in logged.items() if f" {cell}" in name}
        joint = {"shared_global": ["joint"], "shared_local": ["shared"]}
        trainings = [f"train {cell}/{view}, {suffix}" for view in joint.get(arch, ["agent1", "agent2"])]
        assert set(of_cell) == {*trainings, f"evaluate {cell}, {suffix}"}
        for name, log in of_cell.items():
            assert log["group"] == f"{cell}, {suffix}"
            assert set(log["tags"]) == {"lift_barrier", "full", arch, "fast", "2 demos", "train seed 7"}
            config = log["config"]
            shared = arch.startswith("shared")
            assert config["arch"]["name"] == arch and config["arch"]["shared_policy"] == shared
            assert (config["task"], config["constraints"], config["demos"]) == ("lift_barrier", "full", 2)
            assert (config["train_seed"], config["first_scene_seed"]) == (7, 1_000_000)
            assert config["training"]["steps"] == 3 and config["policy"]["width"] == 64
            if log["stage"] == "train":
                assert config["view"] in name
                assert all("loss" in entry for entry in log["history"])
        rows = of_cell[f"evaluate {cell}, {suffix}"]["history"]
        assert [entry["_step"] for entry in rows] == [1, 2]
        assert {"success", "success_paper", "success_without_violation", "with_violation"} <= set(rows[-1])
    assert len(logged) == 1 + 1 + 1 + 2 + 2 + len(ARCHS)
