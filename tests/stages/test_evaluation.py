"""Evaluation records the provenance of its rows, which are never reused after a change of it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, read_rows
from rf_exp.artifacts import commit
from rf_exp.policy import MODEL
from rf_exp.policy.learning.checkpoint import CONFIG, read_tensors, write_tensors

pytestmark = [pytest.mark.render, pytest.mark.slow]

ARGUMENTS = ("task=pick_meat", "demos=2", "scenes=1", "recordings=0", "workers=1", "wandb=disabled")
ARGUMENTS += (
    "picture={width: 64, height: 48}",
    "training.steps=3",
    "policy.encoder.keypoints.steps=2",
    "policy.head.refined.regression_steps=2",
    "training.batch_size=8",
    "task.pick_meat.step_limit=40",  # the hardly trained policy needs all of it
)
ROWS, POLICY = (
    "results/evaluate/pick_meat/separate_local/full-fast-2.jsonl",
    "policies/pick_meat/full/separate_local/fast-2-0",
)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One policy that was hardly trained, evaluated in one scene."""
    out = tmp_path_factory.mktemp("evaluated")
    command = [
        sys.executable,
        "-m",
        "rf_exp.run",
        *ARGUMENTS,
        "episodes=2",  # both succeed, and no process is ended that has started a third one
        "stages=[generate,train,evaluate]",
        f"out={out}",
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    return out


@pytest.fixture
def out(evaluated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(evaluated, tmp_path / "out"))


@pytest.fixture
def evaluate(command, out: Path):
    return lambda *arguments: command(*ARGUMENTS, "stages=[evaluate]", *arguments, f"out={out}")


def test_the_same_evaluation_is_reused_and_its_row_is_complete(evaluate, out: Path) -> None:
    result = evaluate("task.pick_meat.description=Something", "training.device=cpu")
    assert result.returncode == 0 and "nothing to do" in result.stdout
    (row,) = read_rows(out / ROWS, EvaluationRow)
    assert (row.success, row.reason != "", row.commit) == (False, True, commit())


def test_rows_of_final_scenes_are_added_to_the_others(evaluate, out: Path) -> None:
    result = evaluate("first_scene=3000000")
    assert result.returncode == 0 and "1/1 scenes" in result.stdout
    assert [row.scene_seed for row in read_rows(out / ROWS, EvaluationRow)] == [1_000_000, 3_000_000]


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("task.pick_meat.objects.steak.x_m=[0.0,0.1]", "scene.objects.steak.x_m"),
        ("task.pick_meat.objects.steak.asset=cube", "scene.objects.steak.asset"),
        ("task.pick_meat.success.lift_m=0.1", "scene.success.lift_m"),
        ("randomisation.light=0.2", "scene.randomisation.light"),
    ],
)
def test_another_scene_is_refused(evaluate, out: Path, override: str, key: str) -> None:
    result = evaluate(override)
    assert result.returncode == 1
    assert f"{key}: found" in result.stderr and f"delete {out / ROWS}, " in result.stderr
    assert len(read_rows(out / ROWS, EvaluationRow)) == 1


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("training.steps=4", "train.steps: found 3, wanted 4"),
        ("picture.width=80", "policy.width: found 64, wanted 80"),
        ("policy.horizon=16", "policy.horizon: found 32, wanted 16"),
    ],
)
def test_a_policy_of_another_training_is_refused(evaluate, override: str, key: str) -> None:
    result = evaluate(override)
    assert result.returncode == 1
    assert "was made from another configuration" in result.stderr and key in result.stderr


def test_other_acting_values_are_refused(evaluate) -> None:
    """The policy is the same, but its rollouts differ."""
    result = evaluate("policy.head.diffusion.inference_steps=3")
    assert result.returncode == 1 and "was made from another configuration" in result.stderr
    assert "policy.head.diffusion.inference_steps: found 4, wanted 3" in result.stderr


def test_other_weights_are_refused(evaluate, out: Path) -> None:
    (model,) = (out / POLICY).rglob(MODEL)
    tensors, metadata = read_tensors(model)
    name = next(name for name, value in tensors.items() if value.is_floating_point())
    tensors[name] += 1
    write_tensors(model, tensors, metadata)
    result = evaluate()
    assert result.returncode == 1 and "weights.agent1: found" in result.stderr


def test_other_data_is_refused(evaluate, out: Path) -> None:
    (config,) = (out / POLICY).rglob(CONFIG)
    values = json.loads(config.read_text())
    values["data"]["seeds"] = [0, 2]
    config.write_text(json.dumps(values))
    result = evaluate()
    assert result.returncode == 1 and "data.seeds: found [0, 1], wanted [0, 2]" in result.stderr


def test_another_step_limit_is_refused(evaluate) -> None:
    """It is a key of the task."""
    result = evaluate("task.pick_meat.step_limit=150")
    assert result.returncode == 1 and "step_limit: found 40, wanted 150" in result.stderr


def test_training_seeds_share_a_file_and_each_is_checked(command, out: Path) -> None:
    arguments = (*ARGUMENTS, "stages=[train,evaluate]", f"out={out}")
    for _ in range(2):
        assert command(*arguments, "train_seed=1").returncode == 0
    assert [row.train_seed for row in read_rows(out / ROWS, EvaluationRow)] == [0, 1]
    shutil.rmtree(out / POLICY)
    assert command(*arguments, "training.learning_rate=2e-3").returncode == 1
