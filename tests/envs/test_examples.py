"""Short runs of the examples and of the code in docs/environments.md."""

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
    result = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_the_document_lists_every_example() -> None:
    listed = {command.split()[0] for command in EXAMPLES}
    assert listed == {f"examples/{path.name}" for path in (ROOT / "examples").glob("*.py")}


@pytest.mark.parametrize("command", EXAMPLES)
def test_an_example_runs_as_the_document_says(command: str) -> None:
    if "ppo" in command and find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed; it is no part of the set-up")
    output = run(*shlex.split(command)).splitlines()
    if "expert" in command:
        assert "reward 1.0, terminated True" in output[-1]
    if "ppo" in command:
        assert output[-1] == "pick_meat: mean reward 0 after 512 control steps"
    if "random" in command:
        assert output[-1].startswith("scene 0: reward 0, 0 violations, not ['held by both arms'")


@pytest.mark.parametrize(
    ("command", "package", "message"),
    [
        ("examples/ppo.py", "stable_baselines3", "run: pip install stable-baselines3"),
        (
            "examples/foreign/serve.py examples.foreign.hold:make",
            "websockets",
            "pip install websockets msgpack",
        ),
    ],
)
def test_an_example_names_a_missing_package_in_one_line(command: str, package: str, message: str) -> None:
    script = (
        "import runpy, sys; sys.modules[sys.argv[1]] = None; sys.argv[:] = sys.argv[2:]; sys.path[0] = '.'; "
    )
    script += "runpy.run_path(sys.argv[0], run_name='__main__')"
    result = subprocess.run(
        [sys.executable, "-c", script, package, *command.split()], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 1
    assert message in result.stderr and result.stderr.count("\n") == 1


def test_an_example_has_about_forty_lines() -> None:
    lengths = {path.name: path.read_text().count("\n") for path in (ROOT / "examples").glob("*.py")}
    assert max(lengths.values()) <= 45, lengths


@pytest.mark.render
def test_the_python_in_the_document_runs(tmp_path: Path) -> None:
    """All blocks in order, in one process."""
    pytest.importorskip("moviepy", reason="the films of the document need it: the extra envs")
    code = "".join(re.findall(r"^```python\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL))
    code = code.replace("outputs/films", str(tmp_path))
    output = run("-c", f"{code}\nprint(type(env.unwrapped).__name__, agents.possible_agents)")
    assert output.split("\n")[-2] == "CentralEnv ['agent1']"


def test_the_document_has_the_time_of_a_step_for_every_task() -> None:
    table = re.findall(r"^\| `(\w+)` \| \d \|", DOCUMENT, re.MULTILINE)
    assert sorted(table) == list(task_names())
