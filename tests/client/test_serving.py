"""Serving a policy and checking a server, with the protocol of the suite."""

import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.client import Connection, Contract, ServerFailed, check, serving
from rf_exp.client.__main__ import main
from tests.policy.others import says, server, stay

ROOT = Path(__file__).parents[2]
CONTRACT = Contract(2, pictures=False)


class HoldPolicy:
    """Policy that holds the current joint positions, changed by a function."""

    def __init__(self, change: Any = lambda chunk: chunk) -> None:
        self._change = change
        self.observations: list[dict[str, Any]] = []

    def infer(self, observation: dict[str, Any]) -> Mapping[str, Any]:
        self.observations.append(observation)
        return {"actions": self._change(stay(observation)), "more": "said"}


class StatefulPolicy(HoldPolicy):
    def __init__(self) -> None:
        super().__init__()
        self.seeds: list[int] = []

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)


@contextmanager
def served(policy: Any, **metadata: Any) -> Iterator[str]:
    with serving(policy, port=0, metadata=metadata) as running:
        Thread(target=running.run, daemon=True).start()
        yield running.address
        running.stop()


def test_a_policy_receives_observations_and_returns_chunks() -> None:
    policy = HoldPolicy()
    with served(policy, checkpoint="a") as address:
        connection = Connection(address, 5, 5)
        connection.reset(7)
        observation = Contract(2, width=8, height=6).synthetic_observation()
        chunk = connection.act(observation)
        connection.close()
    assert connection.metadata == {"checkpoint": "a"}
    np.testing.assert_array_equal(chunk, stay(observation))
    (received,) = policy.observations
    assert received.keys() == observation.keys() and received["language"] == observation["language"]
    np.testing.assert_array_equal(received["rgb_agent2"], observation["rgb_agent2"], strict=True)


def test_a_stateful_policy_is_reset_and_serves_one_connection_at_a_time() -> None:
    policy = StatefulPolicy()
    with served(policy) as address:
        first = Connection(address, 5, 5)
        with pytest.raises(ServerFailed, match="already serves another connection; use workers=1"):
            Connection(address, 5, 5)
        for seed in (3, 4):
            first.reset(seed)
            for _ in range(2):
                first.act(CONTRACT.synthetic_observation())
        first.close()
        assert policy.seeds == [3, 4]
        check(address, CONTRACT)  # after the first connection was closed


def test_a_factory_makes_a_policy_for_each_connection() -> None:
    policies: list[StatefulPolicy] = []

    def make_policy() -> StatefulPolicy:
        policies.append(StatefulPolicy())
        return policies[-1]

    with served(make_policy) as address:
        connections = [Connection(address, 5, 5) for _ in range(2)]
        for seed, connection in enumerate(connections):
            connection.reset(seed)
            connection.act(CONTRACT.synthetic_observation())
        for connection in connections:
            connection.close()
    assert sorted(each.seeds for each in policies) == [[0], [1]]


def test_a_class_makes_a_policy_for_each_connection() -> None:
    with served(StatefulPolicy) as address:
        connections = [Connection(address, 5, 5) for _ in range(2)]
        for connection in connections:
            assert connection.act(CONTRACT.synthetic_observation()).shape == (5, 2, 8)
            connection.close()


def test_an_error_of_a_policy_ends_only_its_connection(capfd: pytest.CaptureFixture[str]) -> None:
    with served(HoldPolicy()) as address:
        with pytest.raises(ServerFailed, match="reports an error: KeyError: 'qpos'"):
            Connection(address, 5, 5).act({})
        check(address, CONTRACT)
    assert "KeyError: 'qpos'" in capfd.readouterr().err
    nothing: Any = 3
    with pytest.raises(TypeError, match="a int without infer"), serving(nothing, port=0):
        pass


def test_a_valid_server_passes_the_check() -> None:
    with served(HoldPolicy()) as address:
        report = check(address, CONTRACT)
    assert report.steps == (5,) * 4 and len(report.seconds) == 4 and report.notes == ()


def flattened(chunk: NDArray[np.float32]) -> NDArray[np.float32]:
    return chunk.reshape(len(chunk), -1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda chunk: chunk[:, :1], r"answer 1 of episode 1 holds actions of shape \(5, 1, 8\)"),
        (lambda chunk: chunk[0], r"actions of shape \(2, 8\); expected finite numbers \(T, 2, 8\)"),
        (lambda chunk: chunk[:0], r"actions of shape \(0, 2, 8\)"),
        (lambda chunk: chunk * np.nan, "joint 1 of agent 1 is nan in step 0"),
        (lambda chunk: "none", "reports an error: TypeError: a <U4 cannot be sent"),
    ],
)
def test_invalid_chunks_fail_the_check(change: Any, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    with served(HoldPolicy(change)) as address, pytest.raises(ServerFailed, match=message):
        check(address, CONTRACT)


def check_notes(change: Any) -> str:
    with served(HoldPolicy(change)) as address:
        return "\n".join(check(address, CONTRACT).notes)


def scaled(factor: float) -> Any:
    return lambda chunk: np.concatenate([factor * chunk[..., :7], chunk[..., 7:]], axis=-1)


def with_gripper(value: float) -> Any:
    return lambda chunk: np.concatenate([chunk[..., :7], 0 * chunk[..., 7:] + value], axis=-1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled(180 / np.pi), r"agent 1: targets of joints \[2, 4, 6, 7\] are beyond .*\(degrees\?\)"),
        (scaled(0.01), r"agent 2: the first target of joint 6 is .* \(deltas\? targets are absolute\)"),
        (with_gripper(1.5), r"agent 1: its gripper is beyond \[-1 \(closed\), 1 \(open\)\], and clipped"),
        (with_gripper(0.04), r"agent 2: its gripper commands are 0.04 to 0.04, half open \(metres\?\)"),
        (lambda chunk: flattened(chunk)[:, ::-1], "agent 1: the first target of joint"),
    ],
)  # fmt: skip
def test_suspicious_chunks_are_noted(change: Any, message: str) -> None:
    notes = check_notes(change)
    assert re.search(message, notes), notes


@pytest.mark.parametrize("converse", [says(b"", b""), says("no weights")])
def test_other_servers_fail_the_check(converse: Any) -> None:
    with server(converse) as address, pytest.raises(ServerFailed, match=f"policy server {address}"):
        check(address, CONTRACT)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["rf_exp-client", *arguments])
    return main()


def test_the_command_reports_errors(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with served(HoldPolicy(with_gripper(2.0))) as address:
        assert command(monkeypatch, "check", address, "--arms", "2", "--no-pictures") == 0
        output = capsys.readouterr().out
        assert (
            "note: agent 1: its gripper is beyond" in output
            and "chunks of 5 steps, 0.25 s of motion" in output
        )
        # The policy is valid for any number of arms.
        assert command(monkeypatch, "check", address, "--arms", "3", "--no-pictures") == 0
    with served(HoldPolicy(lambda chunk: chunk[:, :1])) as address:
        assert command(monkeypatch, "check", address, "--arms", "2", "--no-pictures") == 1
        assert capsys.readouterr().err.startswith(
            "wrong: answer 1 of episode 1 holds actions of shape (5, 1, 8)"
        )
    for argument, message in (("--task=juggle", "unknown task 'juggle'"), ("--arms=0", "arms is 0")):
        with pytest.raises(SystemExit, match="2"):
            command(monkeypatch, "describe", argument)
        assert message in capsys.readouterr().err


def test_the_command_lists_keys_of_observations(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "describe", "--task", "lift_barrier", "--state", "full", "--depth") == 0
    rows = {line.split()[0]: line.split()[1:3] for line in capsys.readouterr().out.splitlines()}
    assert rows["pose_barrier"] == ["float32", "7"] and rows["depth_agent2"] == ["float32", "240x320"]
    assert rows.keys() == Contract(2, ("barrier",), state="full", depth=True).entries.keys()


# The separate distribution: the same files, with only NumPy, msgpack and websockets.

CHECK_WITHOUT_RF_EXP = """
import sys, threading

sys.modules["rf_exp"] = None

import rf_exp_client as client
policy = type("Policy", (), {"infer": lambda self, seen: {"actions": seen["qpos"][None, :, :8]}})()
with client.serving(policy, port=0) as server:
    threading.Thread(target=server.run, daemon=True).start()
    sys.argv = ["rf_exp-client", "check", server.address, "--task", "take_photo", "--width=8", "--height=6"]
    from rf_exp_client.client.__main__ import main
    code = main()
    server.stop()
theirs = {name.split(".")[0] for name in sys.modules}
print(code, *sorted(theirs & {"rf_exp", "torch", "scipy", "mani_skill", "yaml", "lazy_loader"}))
"""


@pytest.mark.slow
def test_the_wheel_is_independent_of_the_suite(tmp_path: Path) -> None:
    pytest.importorskip("setuptools", minversion="77")
    build = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    # Built in place because its modules are beside it; files of the build go to another folder.
    options = tmp_path / "setup.cfg"
    options.write_text(f"[egg_info]\negg_base = {tmp_path}\n[build]\nbuild_base = {tmp_path}/build\n")
    build_result = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)],
        cwd=ROOT / "plugins/rf_exp_client",
        env=os.environ | {"DIST_EXTRA_CONFIG": str(options)},
        capture_output=True,
        text=True,
    )
    assert build_result.returncode == 0, build_result.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(tmp_path / "site")
        (metadata,) = (name for name in files.namelist() if name.endswith("METADATA"))
        requirements = [
            line for line in files.read(metadata).decode().splitlines() if line.startswith("Requires-Dist")
        ]
    assert [line.split()[1].split(">")[0] for line in requirements] == ["numpy", "msgpack", "websockets"]
    for package in ("client", "texts"):
        expected = {path.name: path.read_bytes() for path in (ROOT / "rf_exp" / package).glob("*.*")}
        folder = tmp_path / "site/rf_exp_client" / package
        assert {path.name: path.read_bytes() for path in folder.glob("*.*")} == expected
    result = subprocess.run(
        [sys.executable, "-P", "-c", CHECK_WITHOUT_RF_EXP],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[-2].startswith("4 answers can be used: chunks of 1 steps"), result.stdout
    assert lines[-1] == "0 rf_exp"  # rf_exp is blocked
