"""docs/library.md shows what works, and the package says what it exports."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rf_exp.library

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs/library.md").read_text("utf-8")


def run(*arguments: str) -> list[str]:
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_the_python_in_the_document_runs() -> None:
    """In its order, in one process, as somebody reads it."""
    code = "".join(re.findall(r"^```python\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL))
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)
    (shown,) = (text for language, text in blocks if not language)
    said = run("-c", f"{code}\nprint(*cell.task.asset('goal_site').points)")
    assert said[:6] == shown.splitlines()
    assert said[6].startswith("failure after ") and said[6].endswith("not is_obj_placed (None, 'cube')")
    assert said[7] == "middle middle_of_cube"


@pytest.mark.slow
def test_the_benchmark_says_how_often_the_example_succeeds() -> None:
    said = run("benchmarks/library.py", "--scenes", "1")
    assert "| TwoRobotPickCube-v1 | 1 of 1 |" in said[-3]
    assert "| TwoRobotStackCube-v1 | 1 of 1 |" in said[-2]


def test_the_example_is_a_page() -> None:
    assert (ROOT / "examples/library/two_robots.py").read_text("utf-8").count("\n") < 90


def test_all_that_is_exported_is_there_and_says_what_it_is() -> None:
    exported = {name: getattr(rf_exp.library, name) for name in rf_exp.library.__all__}
    assert [name for name, each in exported.items() if not inspect.getdoc(each)] == []
    assert sorted(exported) == rf_exp.library.__all__
    assert (ROOT / "rf_exp/py.typed").exists()
