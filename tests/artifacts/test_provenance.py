"""Which code made it: the commit of a checkout, marked where files were changed since."""

import subprocess
from pathlib import Path

import pytest

from rf_exp.artifacts import commit


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
    monkeypatch.setenv("GIT_DIR", "/nowhere")  # as within a hook
    assert commit.__wrapped__(checkout) == head[:12]
    (checkout / "code.py").write_text("2\n")
    assert commit.__wrapped__(checkout) == head[:12] + "+"


def test_no_commit_outside_of_a_checkout(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in a folder of somebody else's checkout, nor where there is no git."""
    (checkout / "site-packages").mkdir()
    assert commit.__wrapped__(checkout / "site-packages") == ""
    monkeypatch.setenv("PATH", "")
    assert commit.__wrapped__(checkout) == ""
