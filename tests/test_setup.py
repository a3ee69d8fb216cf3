"""The set-up on machines that lack something, and when make does it again."""

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
    """What the set-up reads, copied to an empty folder."""
    (tmp_path / "scripts").mkdir()
    for name in ("Makefile", "pyproject.toml", "scripts/setup.sh"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def run(folder: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {"PATH": os.environ["PATH"], "HOME": str(folder)}
    return subprocess.run(command, cwd=folder, env=kept | environment, capture_output=True, text=True)


def test_make_alone_lists_the_targets(clone: Path) -> None:
    done = run(clone, "make")
    assert done.returncode == 0, done.stderr
    listed = [line.split()[1] for line in done.stdout.splitlines()]
    assert {"setup", "demo", "test", "check", "doctor", "bench", "clean", "help"} <= set(listed)


def test_without_a_fitting_python_it_says_what_to_install(clone: Path) -> None:
    done = run(clone, "scripts/setup.sh", PYTHON="false no-such-python")
    assert done.returncode == 1
    assert "set-up stopped: no Python 3.11 or 3.12 among: false no-such-python." in done.stderr
    assert "apt-get install python3 python3-venv" in done.stderr
    assert "make setup PYTHON=/path/to/python3.11" in done.stderr
    assert not (clone / ".venv").exists()


def test_make_fails_with_the_set_up_and_leaves_no_stamp(clone: Path) -> None:
    done = run(clone, "make", "demo", PYTHON="false")
    assert done.returncode == 2
    assert "set-up stopped: no Python 3.11 or 3.12 among: false." in done.stderr
    assert not list(clone.glob(".venv/.setup-*"))


def test_the_set_up_is_done_again_only_when_its_inputs_change(clone: Path) -> None:
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


# An interpreter for a clone: pip is told what to say, the rest is the real one.
STAND_IN = """#!/bin/bash
case "$*" in
    *"pip"*"show -q opencv-python"*) exit 1 ;;
    *"pip"*" install "*) cat "$SAYS" >&2; exit "$ENDS_WITH" ;;
    *"import cv2"* | *"import pinocchio"*) exit 0 ;;
esac
PYTHONPATH="$STUBS" exec "$REAL" "$@"
"""
APT = '#!/bin/sh\n[ "$1" = indextargets ] && echo bookworm-backports\n'  # there, but without packages
NOISE = (
    "WARNING: Location 'file:///mirror/simple/torch/' is ignored: "
    "it is either a non-existing path or lacks a specific scheme.\n"
)


@pytest.fixture
def fitted(clone: Path) -> dict[str, str]:
    """The environment for a set-up whose virtual environment is there; apt-get cannot install anything."""
    (clone / "rf_exp/sim").mkdir(parents=True)
    shutil.copy(ROOT / "rf_exp/sim/vulkan.py", clone / "rf_exp/sim")
    for folder in (".venv/bin", "bin", "stubs"):
        (clone / folder).mkdir(parents=True)
    for path, text in {".venv/bin/python": STAND_IN, "bin/apt-get": APT}.items():
        (clone / path).write_text(text)
        (clone / path).chmod(0o755)
    (clone / "said").write_text(NOISE)
    return {
        "REAL": sys.executable,
        "STUBS": str(clone / "stubs"),
        "SAYS": str(clone / "said"),
        "ENDS_WITH": "0",
        "PATH": f"{clone / 'bin'}:{os.environ['PATH']}",
    }


@pytest.mark.slow
def test_a_driver_that_crashes_is_a_sentence(clone: Path, fitted: dict[str, str]) -> None:
    crash = "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n"
    (clone / "stubs/sapien.py").write_text(crash)  # imported in the place of SAPIEN
    done = run(clone, "scripts/setup.sh", **fitted)
    assert done.returncode == 1
    assert "== Vulkan: no picture yet: the driver ended the process with SIGSEGV (driver: " in done.stdout
    assert "Segmentation fault" not in done.stdout + done.stderr
    assert "set-up stopped: no Vulkan device that SAPIEN accepts, and installing it" in done.stderr


@pytest.mark.render
def test_what_draws_is_named_and_pip_s_notes_about_places_are_not(
    clone: Path, fitted: dict[str, str]
) -> None:
    conflict = "ERROR: mani-skill requires gymnasium, which is not installed.\n"
    (clone / "said").write_text(f"{NOISE}{conflict}{NOISE}")
    done = run(clone, "scripts/setup.sh", **fitted)
    assert done.returncode == 0, done.stderr
    assert re.search(r"== Vulkan: rendered a picture on .+ in [0-9.]+ s \(.+\)\n== ready\n$", done.stdout)
    assert done.stderr == conflict


@pytest.mark.slow
def test_pip_s_errors_are_shown(clone: Path, fitted: dict[str, str]) -> None:
    (clone / "said").write_text(f"{NOISE}ERROR: No matching distribution found for torch==2.13.0\n")
    done = run(clone, "scripts/setup.sh", **{**fitted, "ENDS_WITH": "1"})
    assert done.returncode == 1
    assert "ERROR: No matching distribution found for torch==2.13.0\n" in done.stderr
    assert "set-up stopped: pip could not install" in done.stderr
    assert "Location" not in done.stderr
    assert NOISE in (clone / ".venv/pip.log").read_text()


def test_whatever_is_no_code_is_shipped() -> None:
    """Templates, figures of the paper, specifications: a wheel holds what the package data name."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["*"]
    files = [path for folder in ("rf_exp", "conf") for path in (ROOT / folder).rglob("*") if path.is_file()]
    data = [path for path in files if path.suffix not in (".py", ".pyc")]
    assert {path.suffix for path in data} >= {".yaml", ".html", ".css"}
    assert [path for path in data if not any(path.match(pattern) for pattern in patterns)] == []
