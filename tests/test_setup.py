"""The set-up on machines that lack something, and when make does it again."""

import os
import shutil
import subprocess
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
