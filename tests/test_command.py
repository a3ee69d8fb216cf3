"""Every command ends with an exit code and, after an error, one line."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import hydra
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig

from rf_exp.command import run_guarded, wrap_unexpected_errors
from rf_exp.processes import SHELL_SIGNAL

ROOT = Path(__file__).parents[1]
CONF = ROOT / "conf"


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """`python -m rf_exp.run` with the arguments."""
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.run", *arguments],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=300,
    )


def wrong() -> None:
    raise ZeroDivisionError("by nothing")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_termination_signal_gives_one_line_and_the_usual_exit_code(number: signal.Signals, capsys) -> None:
    signal.signal(number, signal.SIG_DFL)  # the command would keep SIGHUP ignored, as set by nohup
    assert run_guarded(lambda: os.kill(os.getpid(), number)) == 128 + number
    assert capsys.readouterr().err == f"ended by {number.name}; the same command goes on from here\n"
    assert signal.getsignal(number) is signal.SIG_DFL


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--help"], ["--cfg", "job"]])
def test_a_closed_output_pipe_ends_the_command_without_a_traceback(arguments: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "rf_exp.run", *arguments]
    # As in a shell: short output stays in a buffer until the end.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    result = subprocess.run(
        command, stdout=write, stderr=subprocess.PIPE, cwd=ROOT, text=True, timeout=300, env=environment
    )
    os.close(write)
    assert result.returncode == SHELL_SIGNAL + signal.SIGPIPE
    assert result.stderr == "ended: output pipe closed; the same command goes on from here\n"


def test_running_out_of_memory_gives_one_line(capsys) -> None:
    assert run_guarded(lambda: print(np.ones(2**50))) == 1
    message = capsys.readouterr().err
    assert message.startswith("failed: memory ran out (Unable to allocate") and message.count("\n") == 1
    assert "fewer workers" in message and "the same command goes on from here" in message


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
@pytest.mark.parametrize("in_words", [False, True])  # as libraries in C and Rust report it
def test_a_full_disk_gives_one_line(capsys, number: int, in_words: bool) -> None:
    def job() -> None:
        if in_words:
            raise RuntimeError(f"I/O error: {os.strerror(number)} (os error {number})")
        raise OSError(number, os.strerror(number), "some/file")

    assert run_guarded(job) == 1
    message = capsys.readouterr().err
    assert message.startswith("failed: disk full (") and os.strerror(number) in message
    assert message.endswith("; the same command goes on from here\n") and message.count("\n") == 1


@pytest.mark.parametrize(
    "error",
    [MemoryError(), ImportError("libeigenpy.so: failed to map segment from shared object"),
     RuntimeError("can't start new thread"), RuntimeError("std::bad_alloc")],
)  # fmt: skip
def test_all_errors_of_exhausted_memory_are_recognised(capsys, error: Exception) -> None:
    def job() -> None:
        raise error

    assert run_guarded(job) == 1
    message = capsys.readouterr().err
    assert message.startswith("failed: memory ran out (") and "unexpected" not in message


@pytest.mark.slow
def test_a_memory_limit_during_imports_is_reported(tmp_path: Path) -> None:
    """Importing a shared library fails."""
    limit_bytes = 150 * 2**20
    result = subprocess.run(
        [sys.executable, "-m", "rf_exp.run", "stages=[generate]", "render=false", f"out={tmp_path}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes)),
    )
    assert result.returncode == 1
    assert result.stderr.strip().splitlines()[-1].startswith("failed: memory ran out (")
    assert "unexpected" not in result.stderr


def test_an_unexpected_error_gives_one_line_and_a_traceback_file(capsys, monkeypatch) -> None:
    monkeypatch.delenv("HYDRA_FULL_ERROR", raising=False)
    assert run_guarded(wrong) == 1
    message = capsys.readouterr().err
    assert message.startswith("failed: unexpected ZeroDivisionError: by nothing; the traceback is in ")
    assert message.count("\n") == 1
    assert "in wrong" in Path(message.split("the traceback is in ")[1].strip()).read_text()
    assert "HYDRA_FULL_ERROR" not in os.environ


def test_hydra_full_error_shows_the_traceback(capsys, monkeypatch) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    assert run_guarded(wrong) == 1
    message = capsys.readouterr().err
    assert "Traceback" in message and "in wrong" in message
    assert message.splitlines()[-1].startswith("failed: unexpected ZeroDivisionError")


def test_runs_started_within_a_second_have_separate_folders() -> None:
    folders_of: dict[str, set[str]] = {"run": set(), "sweep": set()}
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for _ in range(3):  # in about a second
            composed = compose("config", return_hydra_config=True)
            for kind, folders in folders_of.items():
                folders.add(composed.hydra[kind].dir)
    assert {kind: len(folders) for kind, folders in folders_of.items()} == {"run": 3, "sweep": 3}


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
@wrap_unexpected_errors
def failing_main(config: DictConfig) -> None:
    wrong()


def test_the_traceback_of_a_job_is_written_to_its_folder(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "argv", ["surprised", f"out={tmp_path}"])
    GlobalHydra.instance().clear()
    assert run_guarded(failing_main) == 1
    message = capsys.readouterr().err
    (path,) = tmp_path.glob("runs/*/*/error.log")
    last = f"failed: unexpected ZeroDivisionError: by nothing; the traceback is in {path}"
    assert message.splitlines()[-1] == last and "Traceback" not in message
    assert "in wrong" in path.read_text()


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, capsys) -> None:
    assert run_guarded(lambda: print(tmp_path.read_text())) == 2
    assert capsys.readouterr().err == f"wrong argument: {tmp_path}: Is a directory\n"


@pytest.mark.slow
@pytest.mark.parametrize("out", ["file/out", "file", "/proc/out", "/sys/out"])
def test_an_output_folder_that_cannot_be_created_is_a_wrong_argument(out: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    result = run("stages=[generate]", "render=false", "demos=1", f"out={tmp_path / out}")
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("wrong argument: cannot ") and last.endswith(
        "choose another folder with out=FOLDER"
    )
