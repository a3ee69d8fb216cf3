"""Serving a policy, and checking a server: by the very protocol that the suite speaks."""

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


class Stays:
    """Answers with where the arms are, changed by a function."""

    def __init__(self, change: Any = lambda chunk: chunk) -> None:
        self._change = change
        self.told: list[dict[str, Any]] = []

    def infer(self, observation: dict[str, Any]) -> Mapping[str, Any]:
        self.told.append(observation)
        return {"actions": self._change(stay(observation)), "more": "said"}


class Remembers(Stays):
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


def test_a_policy_is_served_as_the_suite_asks() -> None:
    policy = Stays()
    with served(policy, checkpoint="a") as address:
        connection = Connection(address, 5, 5)
        connection.reset(7)
        observation = Contract(2, width=8, height=6).synthetic_observation()
        chunk = connection.act(observation)
        connection.close()
    assert connection.metadata == {"checkpoint": "a"}
    np.testing.assert_array_equal(chunk, stay(observation))
    (told,) = policy.told
    assert told.keys() == observation.keys() and told["language"] == observation["language"]
    np.testing.assert_array_equal(told["rgb_agent2"], observation["rgb_agent2"], strict=True)


def test_who_remembers_is_told_of_each_episode_and_serves_one_at_a_time() -> None:
    policy = Remembers()
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
        check(address, CONTRACT)  # once the first has left


def test_each_connection_has_its_own_where_a_function_makes_them() -> None:
    made: list[Remembers] = []

    def make() -> Remembers:
        made.append(Remembers())
        return made[-1]

    with served(make) as address:
        both = [Connection(address, 5, 5) for _ in range(2)]
        for seed, connection in enumerate(both):
            connection.reset(seed)
            connection.act(CONTRACT.synthetic_observation())
        for connection in both:
            connection.close()
    assert sorted(each.seeds for each in made) == [[0], [1]]


def test_a_class_makes_a_policy_for_each_connection() -> None:
    with served(Remembers) as address:
        both = [Connection(address, 5, 5) for _ in range(2)]
        for connection in both:
            assert connection.act(CONTRACT.synthetic_observation()).shape == (5, 2, 8)
            connection.close()


def test_what_a_policy_raises_ends_its_connection_alone(capfd: pytest.CaptureFixture[str]) -> None:
    with served(Stays()) as address:
        with pytest.raises(ServerFailed, match="reports an error: KeyError: 'qpos'"):
            Connection(address, 5, 5).act({})
        check(address, CONTRACT)
    assert "KeyError: 'qpos'" in capfd.readouterr().err
    nothing: Any = 3
    with pytest.raises(TypeError, match="a int without infer"), serving(nothing, port=0):
        pass


def test_a_server_that_can_be_used_is_told_so() -> None:
    with served(Stays()) as address:
        report = check(address, CONTRACT)
    assert report.steps == (5,) * 4 and len(report.seconds) == 4 and report.notes == ()


def flat(chunk: NDArray[np.float32]) -> NDArray[np.float32]:
    return chunk.reshape(len(chunk), -1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda chunk: chunk[:, :1], r"answer 1 of episode 1 holds actions of shape \(5, 1, 8\)"),
        (lambda chunk: chunk[0], r"actions of shape \(2, 8\); expected finite numbers \(T, 2, 8\)"),
        (lambda chunk: chunk[:0], r"actions of shape \(0, 2, 8\)"),
        (lambda chunk: chunk * np.nan, "joint 1 of agent 1 is nan in step 0"),
        (lambda chunk: "none", "reports an error: TypeError: a <U4 cannot be sent"),
    ],
)
def test_what_the_suite_would_refuse_is_told(
    change: Any, told: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with served(Stays(change)) as address, pytest.raises(ServerFailed, match=told):
        check(address, CONTRACT)


def told(change: Any) -> str:
    with served(Stays(change)) as address:
        return "\n".join(check(address, CONTRACT).notes)


def scaled(factor: float) -> Any:
    return lambda chunk: np.concatenate([factor * chunk[..., :7], chunk[..., 7:]], axis=-1)


def gripped(value: float) -> Any:
    return lambda chunk: np.concatenate([chunk[..., :7], 0 * chunk[..., 7:] + value], axis=-1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (scaled(180 / np.pi), r"agent 1: targets of joints \[2, 4, 6, 7\] are beyond .*\(degrees\?\)"),
        (scaled(0.01), r"agent 2: the first target of joint 6 is .* \(deltas\? targets are absolute\)"),
        (gripped(1.5), r"agent 1: its gripper is beyond \[-1 \(closed\), 1 \(open\)\], and clipped"),
        (gripped(0.04), r"agent 2: its gripper commands are 0.04 to 0.04, half open \(metres\?\)"),
        (lambda chunk: flat(chunk)[:, ::-1], "agent 1: the first target of joint"),
    ],
)  # fmt: skip
def test_what_the_suite_would_take_and_is_odd_is_told(change: Any, says: str) -> None:
    found = told(change)
    assert re.search(says, found), found


@pytest.mark.parametrize("converse", [says(b"", b""), says("no weights")])
def test_what_is_no_server_is_told(converse: Any) -> None:
    with server(converse) as address, pytest.raises(ServerFailed, match=f"policy server {address}"):
        check(address, CONTRACT)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["rf_exp-client", *arguments])
    return main()


def test_the_command_ends_with_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with served(Stays(gripped(2.0))) as address:
        assert command(monkeypatch, "check", address, "--arms", "2", "--no-pictures") == 0
        said = capsys.readouterr().out
        assert (
            "note: agent 1: its gripper is beyond" in said and "chunks of 5 steps, 0.25 s of motion" in said
        )
        assert (
            command(monkeypatch, "check", address, "--arms", "3", "--no-pictures") == 0
        )  # it stays with any
    with served(Stays(lambda chunk: chunk[:, :1])) as address:
        assert command(monkeypatch, "check", address, "--arms", "2", "--no-pictures") == 1
        assert capsys.readouterr().err.startswith(
            "wrong: answer 1 of episode 1 holds actions of shape (5, 1, 8)"
        )
    for wrong, told in (("--task=juggle", "unknown task 'juggle'"), ("--arms=0", "arms is 0")):
        with pytest.raises(SystemExit, match="2"):
            command(monkeypatch, "describe", wrong)
        assert told in capsys.readouterr().err


def test_the_command_lists_keys(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(monkeypatch, "describe", "--task", "lift_barrier", "--state", "full", "--depth") == 0
    rows = {line.split()[0]: line.split()[1:3] for line in capsys.readouterr().out.splitlines()}
    assert rows["pose_barrier"] == ["float32", "7"] and rows["depth_agent2"] == ["float32", "240x320"]
    assert rows.keys() == Contract(2, ("barrier",), state="full", depth=True).entries.keys()


# The distribution of its own: the same files, with NumPy, msgpack and websockets alone.

ALONE = """
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
def test_its_wheel_needs_nothing_of_the_suite(tmp_path: Path) -> None:
    pytest.importorskip("setuptools", minversion="77")
    build = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    # Where it lies, as its modules lie beside it; what a build leaves goes elsewhere.
    options = tmp_path / "setup.cfg"
    options.write_text(f"[egg_info]\negg_base = {tmp_path}\n[build]\nbuild_base = {tmp_path}/build\n")
    done = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)],
        cwd=ROOT / "plugins/rf_exp_client",
        env=os.environ | {"DIST_EXTRA_CONFIG": str(options)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(tmp_path / "site")
        (told,) = (name for name in files.namelist() if name.endswith("METADATA"))
        needs = [line for line in files.read(told).decode().splitlines() if line.startswith("Requires-Dist")]
    assert [line.split()[1].split(">")[0] for line in needs] == ["numpy", "msgpack", "websockets"]
    for package in ("client", "texts"):
        ours = {path.name: path.read_bytes() for path in (ROOT / "rf_exp" / package).glob("*.*")}
        theirs = tmp_path / "site/rf_exp_client" / package
        assert {path.name: path.read_bytes() for path in theirs.glob("*.*")} == ours
    ran = subprocess.run(
        [sys.executable, "-P", "-c", ALONE],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    said = ran.stdout.splitlines()
    assert said[-2].startswith("4 answers can be used: chunks of 1 steps"), ran.stdout
    assert said[-1] == "0 rf_exp"  # which is blocked
