"""Real worker processes: order of results, time limits, and no process left, however the parent ends."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.processes import Timeout, end_with_parent, in_order
from tests.children import is_alive, session_processes, wait_until

LIMIT_S = 5.0  # includes starting the process


def slept(seconds: float, value: int) -> int:
    time.sleep(seconds)
    return value


def signalled(number: int) -> str:
    os.kill(os.getpid(), number)
    return "still here"


def process(_: int) -> int:
    return os.getpid()


def environment(name: str) -> str | None:
    return os.environ.get(name)


def wrong() -> None:
    raise ArgumentError("not so")


class Awkward(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def raise_awkward() -> None:
    raise Awkward(1, 2)


def save_on_sigterm(path: Path) -> None:
    """Saves half a second after SIGTERM, as training does."""

    def save(*_: object) -> None:
        time.sleep(0.5)
        path.write_text("saved")
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, save)
    path.write_text("at work")
    time.sleep(600)


def fail_after(path: Path) -> None:
    wait_until(path.exists)
    wrong()


@pytest.mark.slow
def test_results_are_in_the_order_of_the_jobs() -> None:
    jobs = [partial(slept, 0.05 * (6 - k), k) for k in range(6)]
    assert list(in_order(jobs, 3)) == list(range(6))


def test_one_worker_without_a_limit_is_this_process() -> None:
    assert list(in_order([partial(process, 0)], 1)) == [os.getpid()]
    assert list(in_order([partial(process, 0)], 1, limit_s=60)) != [os.getpid()]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_over_its_limit_is_killed_and_the_others_continue(workers: int) -> None:
    jobs = [partial(slept, 0, 0), partial(slept, 600, 1), partial(slept, 0, 2), partial(slept, 0, 3)]
    first, late, *rest = in_order(jobs, workers, LIMIT_S)
    assert (first, rest) == (0, [2, 3])
    assert late == Timeout(LIMIT_S, "sleeping")
    assert str(late) == "no result after 5 s; its process, sleeping, was killed"


@pytest.mark.slow
def test_a_stopped_worker_is_killed_at_its_limit() -> None:
    late, other = in_order([partial(signalled, signal.SIGSTOP), partial(slept, 0, 1)], 1, LIMIT_S)
    assert (late.state, other) == ("stopped", 1)


def test_a_killed_worker_gives_one_line_that_says_to_run_again() -> None:
    with pytest.raises(StageError, match=r"process \d+, was ended by SIGKILL .*memory.*run the same command"):
        list(in_order([partial(signalled, signal.SIGKILL)], 2, LIMIT_S))


def test_errors_of_jobs_are_raised_with_their_traceback() -> None:
    with pytest.raises(ArgumentError, match="not so") as caught:
        list(in_order([wrong], 2))
    assert "in wrong" in "".join(caught.value.__notes__)
    with pytest.raises(RuntimeError, match="Awkward: 1 and 2"):  # its class cannot be unpickled
        list(in_order([raise_awkward], 2))


def test_workers_ignore_ctrl_c(tmp_path: Path) -> None:
    """In a separate process: multiprocessing starts its first child in another way."""
    script = tmp_path / "parent.py"
    script.write_text(INTERRUPTED)
    run = subprocess.run(
        [sys.executable, str(script)], env=ENVIRONMENT, capture_output=True, text=True, timeout=60
    )
    assert run.stdout == "['still here']\n", run.stderr


def test_parallel_workers_use_one_core_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert list(in_order([partial(environment, "OMP_NUM_THREADS")], 2)) == ["1"]
    assert list(in_order([partial(environment, "OMP_NUM_THREADS")], 1, LIMIT_S)) == [None]
    assert "OMP_NUM_THREADS" not in os.environ


def test_stopping_early_leaves_no_process() -> None:
    results = in_order([partial(process, k) for k in range(2)] + [partial(slept, 600, 2)] * 2, 2)
    pids = [next(results), next(results)]
    results.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert not any(map(is_alive, pids))


def test_idle_workers_are_reused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are reused by the same parent while its environment is the same; dead ones are replaced."""
    first = set(in_order([partial(process, k) for k in range(4)], 2))
    reused = set(in_order([partial(process, k) for k in range(4)], 2))
    monkeypatch.setenv("WANDB_SERVICE", "of a log that has begun since")
    reused |= set(in_order([partial(process, k) for k in range(4)], 2))
    assert reused <= first and all(map(is_alive, reused))
    monkeypatch.setenv("SOMETHING", "else")
    (other,) = in_order([partial(process, 0)], 1, LIMIT_S)
    assert other not in first and not any(map(is_alive, first))
    os.kill(other, signal.SIGKILL)
    assert wait_until(lambda: not is_alive(other))
    (last,) = in_order([partial(process, 0)], 1, LIMIT_S)
    assert last != other


@pytest.mark.slow
def test_a_terminated_job_may_save_first(tmp_path: Path) -> None:
    path = tmp_path / "state"
    with pytest.raises(ArgumentError):
        list(in_order([partial(save_on_sigterm, path), partial(fail_after, path)], 2, grace_s=30.0))
    assert path.read_text() == "saved"


ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": f"{Path(__file__).parents[1]}:{os.environ.get('PYTHONPATH', '')}",
}
INTERRUPTED = """
import signal
from functools import partial
from tests.test_processes import signalled
from rf_exp.processes import in_order
if __name__ == "__main__":
    print(list(in_order([partial(signalled, signal.SIGINT)], 2)))
"""
PARENT = """
import sys, time
from functools import partial
from tests.test_processes import process, slept
from rf_exp.processes import in_order
if __name__ == "__main__":
    jobs = [partial(process, k) for k in range(2)] + [partial(slept, 600, k) for k in range(2)]
    results = in_order(jobs, 2)
    print(next(results), next(results), flush=True)
    next(results)
"""


LAUNCHER = """
import os, sys, time
from joblib import Parallel, delayed
from tests.test_processes import as_a_job
if __name__ == "__main__":
    pipes = Parallel(n_jobs=2)(delayed(as_a_job)(1) for k in range(2))
    print(*pipes, flush=True)
    Parallel(n_jobs=2)(delayed(as_a_job)(600) for k in range(2))
"""


def as_a_job(seconds: float) -> int:
    """Runs like a job in a process of a launcher."""
    end_with_parent()
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.slow
@pytest.mark.parametrize("code", [PARENT, LAUNCHER], ids=["workers", "launcher"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_children_end_with_their_parent(number: int, code: str, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(code)
    parent = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
        start_new_session=True,
    )
    assert parent.stdout is not None
    with parent:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2 and all(map(is_alive, pids))
        parent.send_signal(number)
        parent.wait(30)
    assert wait_until(lambda: not session_processes(parent.pid), 5.0), session_processes(parent.pid)
