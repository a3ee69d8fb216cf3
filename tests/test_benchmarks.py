"""Benchmarks that need nothing but the package run, and end with JSON. What they measure is theirs."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def last_line(command: str) -> dict:
    """The JSON with which a benchmark ends."""
    script, *arguments = command.split()
    result = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / script, *arguments],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    ["loader.py --size compact --batches 1", "train_step.py --steps 1 --batch 8", "policy_call.py --calls 1"],
)
def test_a_benchmark_ends_with_a_line_of_json(command: str) -> None:
    assert last_line(command)["size"] == "compact"


@pytest.mark.slow
def test_a_step_of_an_environment_costs_little_more_than_the_simulator_s() -> None:
    """The bound is 1.1, measured at leisure; other work on the machine may take its share here."""
    found = last_line("environment.py --tasks lift_barrier --repeats 2")
    assert found["gymnasium_worst"] == found["gymnasium"]["lift_barrier"] < 1.3
    assert found["pettingzoo_worst"] == found["pettingzoo"]["lift_barrier"] < 1.3
