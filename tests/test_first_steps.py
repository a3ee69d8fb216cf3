"""First steps of a new user: commands of the console script, the notebook, the container."""

import json
import re
import runpy
import sys
from pathlib import Path

import matplotlib
import pytest

from rf_exp import entry

ROOT = Path(__file__).parents[1]


def exit_code_of(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["rf-exp", *arguments])
    with pytest.raises(SystemExit) as ended:
        sys.exit(entry.main())
    return ended.value.code


@pytest.mark.slow
@pytest.mark.parametrize("command", ["data", "doctor"])
def test_the_first_word_names_a_command(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code_of(monkeypatch, command, "--help") == 0
    assert f"usage: python -m rf_exp.{command}" in capsys.readouterr().out


def test_every_command_is_a_module_and_is_listed_in_the_help() -> None:
    listed = (ROOT / "conf/config.yaml").read_text().partition("in place of run: ")[2].splitlines()[0]
    assert set(re.findall(r"\w+", listed)) == set(entry.COMMANDS)
    for name in entry.COMMANDS:
        assert (ROOT / f"rf_exp/{name}.py").exists() or (ROOT / f"rf_exp/{name}/__main__.py").exists()


def test_other_first_words_are_arguments_of_the_experiment(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code_of(monkeypatch, "docter") == 2
    assert "'docter' is not understood; did you mean doctor?" in capsys.readouterr().err
    assert exit_code_of(monkeypatch, "lift") == 2
    assert "'lift' is not understood" in capsys.readouterr().err


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    matplotlib.use("Agg")
    cells = json.loads((ROOT / "examples/quickstart.ipynb").read_text("utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells if cell["cell_type"] == "code")
    (tmp_path / "cells.py").write_text(
        "\n".join(code).replace("demos=2", "demos=1").replace("list(map(", "found = list(map(")
    )
    variables = runpy.run_path(str(tmp_path / "cells.py"))
    assert len(variables["store"]) == 1 and variables["found"] == []
    assert (tmp_path / "quickstart/joints.png").stat().st_size > 0


def test_the_container_has_the_packages_of_the_set_up() -> None:
    setup, container = (
        (ROOT / name).read_text().replace("\\\n", " ") for name in ("scripts/setup.sh", "Dockerfile")
    )
    install_lines = [line for line in setup.splitlines() if line.strip().startswith("apt_install ")]
    expected = {
        word
        for line in install_lines
        for word in re.findall(r"\b(?:mesa|lib)[\w-]+", line.rpartition('"')[2])
    }
    installed = {
        word for part in container.split("apt-get install")[1:] for word in part.partition("&&")[0].split()
    }
    assert expected and expected == {each for each in installed if not each.startswith("-")} - {
        "bookworm-backports"
    }
    assert "bookworm-backports main" in container and "scripts/setup.sh" in container
