"""Correction: every rollout counts, steps of the expert are stored, and finished rounds are not repeated."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows
from rf_exp.experiment import CORRECTION_SEED, CORRECTION_SEEDS
from rf_exp.store import Store

pytestmark = [pytest.mark.render, pytest.mark.slow]

ARGUMENTS = (
    *("task=pick_meat", "demos=2", "scenes=1", "recordings=0", "films=0", "wandb=disabled", "workers=1"),
    *("picture={width: 64, height: 48}", "training.steps=3", "policy.encoder.keypoints.steps=2"),
    *("policy.head.refined.regression_steps=2", "training.batch_size=8"),
    "task.pick_meat.step_limit=60",
)
ROUNDS = "dagger={rounds: 2, rollouts: 1}"
DATA = "data/pick_meat/full/corrected-separate_local-fast+dagger{}-2-0.zarr"
ROWS = "results/correct/pick_meat/separate_local/full-fast+dagger{}-2-0.jsonl"


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corrected")


def test_the_expert_takes_over_where_policies_fail(command, corrected: Path) -> None:
    result = command(*ARGUMENTS, ROUNDS, "stages=[generate,train,evaluate]", f"out={corrected}")
    assert result.returncode == 0, result.stderr
    queries = 0
    for rounds in (1, 2):
        made = read_rows(corrected / ROWS.format(rounds), GenerationRow)
        first = CORRECTION_SEED + CORRECTION_SEEDS * (rounds - 1)
        assert [row.seed for row in made] == [first]  # hardly trained, the policies fail in it
        assert all(row.success and row.attempts for row in made)
        queries += sum(row.attempts for row in made)
        store = Store.open(corrected / DATA.format(rounds))
        assert len(store) == 2 + rounds and store.seeds[-1] == first
        for subgoal in store.by_episode(store.subgoal)[2:]:
            own = subgoal[:, 0] >= 0
            assert own[-1] and (np.diff(own.astype(int)) >= 0).all()
    (row,) = read_rows(
        corrected / "results/evaluate/pick_meat/separate_local/full-fast+dagger2-2.jsonl", EvaluationRow
    )
    assert (row.recipe, row.queries, row.demos) == ("fast+dagger2", queries, 2)


def test_existing_rounds_are_not_repeated_and_lost_ones_are(command, corrected: Path) -> None:
    arguments = (*ARGUMENTS, "dagger={rounds: 1, rollouts: 1}", "stages=[train]", f"out={corrected}")
    again = command(*arguments)
    assert again.returncode == 0 and "correction 1: 1 demonstrations are there, nothing to do" in again.stdout
    path = corrected / DATA.format(1)
    before = Store.open(path).digest()
    shutil.rmtree(path)
    (corrected / ROWS.format(1)).unlink()
    assert command(*arguments).returncode == 0 and Store.open(path).digest() == before


def test_other_rounds_are_refused(command, corrected: Path) -> None:
    for override, expected in (
        ("dagger={rounds: 1, rollouts: 3}", "rollouts: found 1, wanted 3"),
        ("dagger.rounds=-1", "dagger.rounds is -1; expected 0 to 9"),
        ("dagger.rollouts=0", "dagger.rollouts is 0; expected 1 to 10000"),
    ):
        result = command(*ARGUMENTS, override, "stages=[train]", f"out={corrected}")
        assert result.returncode in (1, 2) and expected in result.stderr
