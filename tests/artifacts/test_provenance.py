"""Provenance of code: the commit of a checkout, marked if files were changed."""

import json
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import rf_exp
from rf_exp.artifacts import code_version, commit


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    (tmp_path / "code.py").write_text("1\n")
    author = ["-c", "user.name=Test", "-c", "user.email=test@example.org"]
    for arguments in (["init"], ["add", "code.py"], [*author, "commit", "-m", "first"]):
        subprocess.run(["git", "-C", str(tmp_path), *arguments], check=True, capture_output=True)
    return tmp_path


def test_the_commit_of_a_checkout(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = subprocess.run(
        ["git", "-C", str(checkout), "rev-parse", "HEAD"], check=True, capture_output=True, text=True
    ).stdout.strip()
    monkeypatch.setenv("GIT_DIR", "/nowhere")  # as in a git hook
    assert commit.__wrapped__(checkout) == head[:12]
    (checkout / "code.py").write_text("2\n")
    assert commit.__wrapped__(checkout) == head[:12] + "+"


def test_no_commit_outside_of_a_checkout(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither for an untracked folder inside another checkout, nor without git."""
    (checkout / "site-packages").mkdir()
    assert commit.__wrapped__(checkout / "site-packages") == ""
    monkeypatch.setenv("PATH", "")
    assert commit.__wrapped__(checkout) == ""


def test_code_is_named_by_its_commit_or_its_version(checkout: Path) -> None:
    assert code_version(checkout) == commit(checkout) != ""
    (checkout / "site-packages").mkdir()
    assert code_version(checkout / "site-packages") == f"rf_exp-{metadata.version('rf_exp')}"


@pytest.mark.slow
def test_a_store_of_an_installed_package_names_its_version(tmp_path: Path) -> None:
    shutil.copytree(
        Path(rf_exp.__file__).parent, tmp_path / "rf_exp", ignore=shutil.ignore_patterns("__pycache__")
    )
    script = "from rf_exp.store import Store; Store.create('s.zarr', {'task': 'lift_barrier'}, 1, (), 0, 0)"
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    attributes = json.loads((tmp_path / "s.zarr/zarr.json").read_text())["attributes"]
    assert attributes["commit"] == f"rf_exp-{metadata.version('rf_exp')}"
