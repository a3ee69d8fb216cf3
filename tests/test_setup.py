"""The set-up on incomplete machines, and when make repeats it."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A copy of the files that the set-up reads."""
    (tmp_path / "scripts").mkdir()
    for name in ("Makefile", "pyproject.toml", "scripts/setup.sh"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def run(folder: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    base = {"PATH": os.environ["PATH"], "HOME": str(folder)}
    return subprocess.run(command, cwd=folder, env=base | environment, capture_output=True, text=True)


def test_make_alone_lists_the_targets(clone: Path) -> None:
    result = run(clone, "make")
    assert result.returncode == 0, result.stderr
    listed = [line.split()[1] for line in result.stdout.splitlines()]
    assert {"setup", "demo", "test", "check", "doctor", "bench", "clean", "help"} <= set(listed)


def test_without_a_supported_python_the_advice_says_what_to_install(clone: Path) -> None:
    result = run(clone, "scripts/setup.sh", PYTHON="false no-such-python")
    assert result.returncode == 1
    assert "set-up stopped: no Python 3.11 or 3.12 among: false no-such-python." in result.stderr
    assert "apt-get install python3 python3-venv" in result.stderr
    assert "make setup PYTHON=/path/to/python3.11" in result.stderr
    assert not (clone / ".venv").exists()


def test_make_fails_with_the_set_up_and_writes_no_stamp(clone: Path) -> None:
    result = run(clone, "make", "demo", PYTHON="false")
    assert result.returncode == 2
    assert "set-up stopped: no Python 3.11 or 3.12 among: false." in result.stderr
    assert not list(clone.glob(".venv/.setup-*"))


def test_the_set_up_is_repeated_only_if_its_inputs_change(clone: Path) -> None:
    stamp = run(
        clone, "make", "--no-print-directory", "--eval", "stamp: ; @echo $(STAMP)", "stamp"
    ).stdout.strip()
    assert "scripts/setup.sh" in run(clone, "make", "-n", "setup").stdout
    (clone / stamp).parent.mkdir()
    (clone / stamp).touch()
    assert "scripts/setup.sh" not in run(clone, "make", "-n", "setup").stdout
    with (clone / "pyproject.toml").open("a") as file:
        file.write("\n# another dependency\n")
    assert "scripts/setup.sh" in run(clone, "make", "-n", "setup").stdout


def test_without_pictures_the_demo_ends_with_the_demonstrations(clone: Path) -> None:
    assert (
        "-m rf_exp.run render=false stages=[generate]" in run(clone, "make", "-n", "demo", "RENDER=no").stdout
    )
    assert '-m "not render"' in run(clone, "make", "-n", "test", "RENDER=no").stdout
    assert "render=false" not in run(clone, "make", "-n", "demo").stdout


# An interpreter for a clone: pip prints a given text, all else goes to the real interpreter.
FAKE_PYTHON = """#!/bin/bash
case "$*" in
    *"pip"*"show -q opencv-python"*) exit 1 ;;
    *"pip"*" install "*) cat "$SAYS" >&2; exit "$ENDS_WITH" ;;
    *"import cv2"* | *"import pinocchio"*) exit 0 ;;
esac
PYTHONPATH="$STUBS" exec "$REAL" "$@"
"""
FAKE_APT = '#!/bin/sh\n[ "$1" = indextargets ] && echo bookworm-backports\n'  # exists, but has no packages
PIP_WARNING = (
    "WARNING: Location 'file:///mirror/simple/torch/' is ignored: "
    "it is either a non-existing path or lacks a specific scheme.\n"
)


@pytest.fixture
def with_venv(clone: Path) -> dict[str, str]:
    """Environment variables of a set-up with a virtual environment, in which apt-get installs nothing."""
    (clone / "rf_exp/sim").mkdir(parents=True)
    shutil.copy(ROOT / "rf_exp/sim/vulkan.py", clone / "rf_exp/sim")
    for folder in (".venv/bin", "bin", "stubs"):
        (clone / folder).mkdir(parents=True)
    for path, text in {".venv/bin/python": FAKE_PYTHON, "bin/apt-get": FAKE_APT}.items():
        (clone / path).write_text(text)
        (clone / path).chmod(0o755)
    (clone / "said").write_text(PIP_WARNING)
    return {
        "REAL": sys.executable,
        "STUBS": str(clone / "stubs"),
        "SAYS": str(clone / "said"),
        "ENDS_WITH": "0",
        "PATH": f"{clone / 'bin'}:{os.environ['PATH']}",
    }


@pytest.mark.slow
def test_a_crashing_driver_is_reported_in_a_sentence(clone: Path, with_venv: dict[str, str]) -> None:
    crash = "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n"
    (clone / "stubs/sapien.py").write_text(crash)  # imported instead of SAPIEN
    result = run(clone, "scripts/setup.sh", **with_venv)
    assert result.returncode == 1
    assert "== Vulkan: no picture yet: the driver ended the process with SIGSEGV (driver: " in result.stdout
    assert "Segmentation fault" not in result.stdout + result.stderr
    assert "set-up stopped: no Vulkan device that SAPIEN accepts, and installing it" in result.stderr


@pytest.mark.render
def test_the_renderer_is_named_and_location_warnings_of_pip_are_hidden(
    clone: Path, with_venv: dict[str, str]
) -> None:
    conflict = "ERROR: mani-skill requires gymnasium, which is not installed.\n"
    (clone / "said").write_text(f"{PIP_WARNING}{conflict}{PIP_WARNING}")
    result = run(clone, "scripts/setup.sh", **with_venv)
    assert result.returncode == 0, result.stderr
    assert re.search(r"== Vulkan: rendered a picture on .+ in [0-9.]+ s \(.+\)\n== ready\n$", result.stdout)
    assert result.stderr == conflict


@pytest.mark.slow
def test_pip_s_errors_are_shown(clone: Path, with_venv: dict[str, str]) -> None:
    (clone / "said").write_text(f"{PIP_WARNING}ERROR: No matching distribution found for torch==2.13.0\n")
    result = run(clone, "scripts/setup.sh", **{**with_venv, "ENDS_WITH": "1"})
    assert result.returncode == 1
    assert "ERROR: No matching distribution found for torch==2.13.0\n" in result.stderr
    assert "set-up stopped: pip could not install" in result.stderr
    assert "Location" not in result.stderr
    assert PIP_WARNING in (clone / ".venv/pip.log").read_text()


def test_all_data_files_are_in_the_wheel() -> None:
    """Templates, figures of the paper, specifications: package-data has a pattern for each."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["*"]
    files = [path for folder in ("rf_exp", "conf") for path in (ROOT / folder).rglob("*") if path.is_file()]
    data = [path for path in files if path.suffix not in (".py", ".pyc")]
    assert {path.suffix for path in data} >= {".yaml", ".html", ".css"}
    assert [path for path in data if not any(path.match(pattern) for pattern in patterns)] == []
