"""Killed workers and runs, and the same command run again, with real processes and signals.

`benchmarks/kills.py` repeats this at random times.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows
from rf_exp.artifacts import locked
from rf_exp.store import Store
from tests.children import session_processes, wait_until, worker_processes

ROOT = Path(__file__).parents[1]
Command = Callable[..., subprocess.CompletedProcess[str]]
STATES = (
    *("stages=[generate]", "task=pick_meat", "render=false", "episodes=2"),
    *("recordings=0", "workers=1", "wandb=disabled"),
)
TINY = (
    "demos=2",
    "scenes=2",
    "recordings=0",
    "films=0",
    "workers=1",
    "arch=shared_local",
    "wandb=disabled",
    "picture={width: 64, height: 48}",
)
TINY = (
    *TINY,
    "policy.encoder.keypoints.steps=2",
    "policy.head.refined.regression_steps=2",
    "training.batch_size=8",
    "training.log_every=5",
)
LONG_S = 900.0  # limit for a test that hangs


STARTED: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def kill_leftovers() -> Iterator[None]:
    """Kills the processes that a failed test left."""
    yield
    while STARTED:
        for pid in session_processes(STARTED.pop().pid):
            os.kill(pid, signal.SIGKILL)


def start(*arguments: str) -> subprocess.Popen[str]:
    """The command in a session of its own."""
    run = subprocess.Popen(
        [sys.executable, "-m", "rf_exp.run", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    STARTED.append(run)
    return run


def wait_for(run: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, standard output and standard error, once no process of the run is left."""
    out, errors = run.communicate(timeout=LONG_S)
    assert wait_until(lambda: not session_processes(run.pid), 5.0), session_processes(run.pid)
    return run.returncode, out, errors


@pytest.mark.slow
def test_a_run_resumed_after_a_kill_gives_the_same_bytes(command: Command, tmp_path: Path) -> None:
    undisturbed_run = command(*STATES, f"out={tmp_path / 'whole'}")
    assert undisturbed_run.returncode == 0, undisturbed_run.stderr

    run = start(*STATES, f"out={tmp_path / 'killed'}")
    assert wait_until(lambda: worker_processes(run.pid), LONG_S)
    os.kill(worker_processes(run.pid)[0], signal.SIGKILL)
    code, _, errors = wait_for(run)
    assert code == 1 and "Traceback" not in errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith("failed: a worker, process ") and "was ended by SIGKILL" in last
    assert last.endswith("run the same command again, it goes on from here")

    run = start(*STATES, f"out={tmp_path / 'killed'}")
    assert wait_until(lambda: worker_processes(run.pid), LONG_S)
    run.kill()
    code, _, _ = wait_for(run)
    assert code == -signal.SIGKILL

    code, _, errors = wait_for(start(*STATES, f"out={tmp_path / 'killed'}"))
    assert code == 0, errors
    expected, resumed = (tmp_path / name / "data/pick_meat/full/fast.zarr" for name in ("whole", "killed"))
    assert Store.open(expected).digest() == Store.open(resumed).digest()
    rows = read_rows(tmp_path / "killed/results/generate/pick_meat/full-disturbed.jsonl", GenerationRow)
    assert [row.seed for row in rows] == [0, 1]


@pytest.mark.slow
def test_a_seed_over_the_time_limit_is_a_row_with_the_reason(tmp_path: Path) -> None:
    wait_for(start(*STATES, "seed_limit_s=1", f"out={tmp_path}"))  # no process starts in a second
    rows = read_rows(tmp_path / "results/generate/pick_meat/full-disturbed.jsonl", GenerationRow)
    assert [(row.seed, row.success) for row in rows] == [(0, False), (1, False)]
    assert all(row.reason.startswith("no result after 1 s; its process, ") for row in rows)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations with small pictures."""
    out = tmp_path_factory.mktemp("data")
    code, _, errors = wait_for(start(*TINY, "stages=[generate]", f"out={out}"))
    assert code == 0, errors
    return out


@pytest.mark.render
@pytest.mark.slow
def test_terminated_training_saves_its_state_and_resumes(data: Path) -> None:
    arguments = (*TINY, "stages=[train]", "training.steps=100000", "train_seed=1", f"out={data}")
    folder = data / "policies/lift_barrier/full/shared_local/fast-2-1"
    run = start(*arguments)
    assert wait_until((folder / "shared/curves.csv").exists, LONG_S)
    time.sleep(1.0)
    run.terminate()
    code, _, errors = wait_for(run)
    assert code == 128 + signal.SIGTERM
    assert errors.strip().splitlines()[-1] == "ended by SIGTERM; the same command goes on from here"
    assert (folder / "shared/state.safetensors").exists()

    with locked(folder / ".shared.lock", "shared"):  # as if its trainer were still running
        run = start(*arguments)
        assert run.stdout is not None
        guard = threading.Timer(LONG_S, run.kill)
        guard.start()
        line = next(line for line in run.stdout if line.startswith("waiting for "))
        assert line.startswith(f"waiting for {folder}/shared: process {os.getpid()} on ")
        before = (folder / "shared/curves.csv").read_bytes()
        time.sleep(2.0)
        assert (folder / "shared/curves.csv").read_bytes() == before
        guard.cancel()
        run.kill()
        wait_for(run)


@pytest.mark.render
@pytest.mark.slow
def test_a_scene_over_the_time_limit_is_a_row(data: Path) -> None:
    arguments = (*TINY, "stages=[train,evaluate]", "training.steps=3", "seed_limit_s=1", f"out={data}")
    code, _, errors = wait_for(start(*arguments))
    assert code == 0, errors
    rows = read_rows(data / "results/evaluate/lift_barrier/shared_local/full-fast-2.jsonl", EvaluationRow)
    assert [(row.scene_seed, row.success) for row in rows] == [(1_000_000, False), (1_000_001, False)]
