"""The code in docs/library.md runs, and all exports of the package have docstrings."""

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
    result = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


@pytest.mark.slow
def test_the_python_in_the_document_runs() -> None:
    """All blocks in order, in one process."""
    code = "".join(re.findall(r"^```python\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL))
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)
    (expected,) = (text for language, text in blocks if not language)
    output = run("-c", f"{code}\nprint(*cell.task.asset('goal_site').points)")
    assert output[:6] == expected.splitlines()
    assert output[6].startswith("failure after ") and output[6].endswith("not is_obj_placed (None, 'cube')")
    assert output[7] == "middle middle_of_cube"


@pytest.mark.slow
def test_the_benchmark_reports_successes_of_the_example() -> None:
    output = run("benchmarks/library.py", "--scenes", "1")
    assert "| TwoRobotPickCube-v1 | 1 of 1 |" in output[-3]
    assert "| TwoRobotStackCube-v1 | 1 of 1 |" in output[-2]


def test_the_example_fits_on_a_page() -> None:
    assert (ROOT / "examples/library/two_robots.py").read_text("utf-8").count("\n") < 90


def test_all_exports_exist_and_have_docstrings() -> None:
    exported = {name: getattr(rf_exp.library, name) for name in rf_exp.library.__all__}
    assert [name for name, each in exported.items() if not inspect.getdoc(each)] == []
    assert sorted(exported) == rf_exp.library.__all__
    assert (ROOT / "rf_exp/py.typed").exists()
