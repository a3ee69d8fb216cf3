"""The examples run, in a short form, and docs/environments.md shows what works."""

import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from rf_exp.envs.core import task_names

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs/environments.md").read_text("utf-8")
EXAMPLES = re.findall(r"^python (examples/\S+ [^#\n]+)", DOCUMENT, re.MULTILINE)

pytestmark = pytest.mark.slow


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_document_shows_every_example() -> None:
    shown = {command.split()[0] for command in EXAMPLES}
    assert shown == {f"examples/{path.name}" for path in (ROOT / "examples").glob("*.py")}


@pytest.mark.parametrize("command", EXAMPLES)
def test_an_example_runs_as_the_document_says(command: str) -> None:
    if "ppo" in command and find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed; it is no part of the set-up")
    said = run(*shlex.split(command)).splitlines()
    if "expert" in command:
        assert "reward 1.0, terminated True" in said[-1]
    if "ppo" in command:
        assert said[-1] == "pick_meat: mean reward 0 after 512 control steps"
    if "random" in command:
        assert said[-1].startswith("scene 0: reward 0, 0 violations, not ['held by both arms'")


@pytest.mark.parametrize(
    ("command", "lacks", "told"),
    [
        ("examples/ppo.py", "stable_baselines3", "run: pip install stable-baselines3"),
        (
            "examples/foreign/serve.py examples.foreign.hold:make",
            "websockets",
            "pip install websockets msgpack",
        ),
    ],
)
def test_an_example_says_what_it_lacks_in_a_line(command: str, lacks: str, told: str) -> None:
    without = (
        "import runpy, sys; sys.modules[sys.argv[1]] = None; sys.argv[:] = sys.argv[2:]; sys.path[0] = '.'; "
    )
    without += "runpy.run_path(sys.argv[0], run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", without, lacks, *command.split()], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert told in done.stderr and done.stderr.count("\n") == 1


def test_an_example_has_about_forty_lines() -> None:
    lengths = {path.name: path.read_text().count("\n") for path in (ROOT / "examples").glob("*.py")}
    assert max(lengths.values()) <= 45, lengths


@pytest.mark.render
def test_the_python_in_the_document_runs(tmp_path: Path) -> None:
    """In its order, in one process, as somebody reads it."""
    pytest.importorskip("moviepy", reason="the films of the document need it: the extra envs")
    code = "".join(re.findall(r"^```python\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL))
    code = code.replace("outputs/films", str(tmp_path))
    said = run("-c", f"{code}\nprint(type(env.unwrapped).__name__, agents.possible_agents)")
    assert said.split("\n")[-2] == "CentralEnv ['agent1']"


def test_the_document_says_what_a_step_costs_in_every_task() -> None:
    table = re.findall(r"^\| `(\w+)` \| \d \|", DOCUMENT, re.MULTILINE)
    assert sorted(table) == list(task_names())
