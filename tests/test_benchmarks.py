"""Benchmarks that need nothing but the package run, and end with JSON. What they measure is theirs."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "command",
    ["loader.py --size compact --batches 1", "train_step.py --steps 1 --batch 8", "policy_call.py --calls 1"],
)
def test_a_benchmark_ends_with_a_line_of_json(command: str) -> None:
    script, *arguments = command.split()
    result = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / script, *arguments],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout.splitlines()[-1])["size"] == "compact"
