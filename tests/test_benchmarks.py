"""Benchmarks that need only the package run and end with a line of JSON; their figures are not tested."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def last_line(command: str) -> dict:
    """The JSON in the last line of a benchmark."""
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
    """The bound on an idle machine is 1.1; here, other processes may run beside the test."""
    costs = last_line("environment.py --tasks lift_barrier --repeats 2")
    assert costs["gymnasium_worst"] == costs["gymnasium"]["lift_barrier"] < 1.3
    assert costs["pettingzoo_worst"] == costs["pettingzoo"]["lift_barrier"] < 1.3
