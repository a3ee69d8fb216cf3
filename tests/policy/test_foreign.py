"""Foreign policies: observations, chunks, factories, servers; every fault is reported and loses no row."""

import os
import re
import socket
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.ablation import EvaluationRow, read_rows
from rf_exp.client import pack, unpack
from rf_exp.errors import ArgumentError, StageError
from rf_exp.observations import Observations
from rf_exp.policy import Foreign, foreign_runners, make_policy, rollout
from rf_exp.policy.foreign.remote import Remote
from rf_exp.policy.foreign.runner import ForeignRunner
from rf_exp.robots import DEFAULT
from rf_exp.tasks import Task
from rf_exp.types import Scene, Verdict
from tests.conftest import experiment, read_task
from tests.policy.others import Answer, Policy, says, server, silent, stay
from tests.policy.scripted import Puppets
from tests.scenes import start_scene

ROOT = Path(__file__).parents[2]
TWO = read_task("lift_barrier")
FASTEST_RAD = 0.045
SPEC = Foreign("theirs", "a.b:c", None, None, 5.0, 5.0, None, None, 0, Observations(state="joints"))
BLIND = ("foreign.observations.pictures=false", "render=false")


@pytest.fixture(autouse=True)
def direct(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loopback is reached directly, whatever proxy this machine has."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


def make_runner(answer: Answer, task: Task = TWO, spec: Foreign = SPEC) -> tuple[ForeignRunner, Policy]:
    policy = Policy(answer)
    return ForeignRunner(spec, policy, task, FASTEST_RAD), policy


def judge(scene: Scene) -> Verdict:
    return Verdict(False, False, {})


def commands(answer: Answer, steps: int = 6, **options: Any) -> NDArray[np.float64]:
    """Commands (T, N, 8) of a rollout."""
    runner, _ = make_runner(answer, **options)
    world = Puppets(options.get("task", TWO))
    rollout(world, judge, [runner], 7, steps)
    return np.stack(world.commands)


# -- observations and chunks --------------------------------------------------------------------------


def test_a_policy_receives_observations_and_the_start_of_episodes(task: Task) -> None:
    spec = replace(SPEC, observations=Observations(state="full", language=True))
    runner, policy = make_runner(stay, task, spec)
    for seed in (3, 4):
        rollout(Puppets(task), judge, [runner], seed, 7)
    assert policy.seeds == [3, 4] and len(policy.observations) == 4  # chunks of 5 for 7 steps
    agents, first = len(task.agents), policy.observations[0]
    assert {key: value.shape for key, value in first.items() if key != "language"} == {
        "qpos": (agents, 9),
        "qvel": (agents, 9),
        **{f"pose_{name}": (7,) for name in task.objects},
    }
    assert first["language"] == task.description
    assert np.array_equal(first["qpos"], start_scene(task, 3).qpos.astype(np.float32))


def test_chunks_of_both_shapes_give_the_same_commands(task: Task) -> None:
    def flat(observation: dict[str, Any]) -> NDArray[np.float32]:
        return stay(observation).reshape(5, -1)

    assert np.array_equal(commands(stay, task=task), commands(flat, task=task))
    assert np.array_equal(commands(stay, task=task), commands(lambda seen: stay(seen).tolist(), task=task))


def test_the_configured_number_of_steps_of_a_chunk_is_executed() -> None:
    runner, policy = make_runner(stay, spec=replace(SPEC, action_steps=2))
    rollout(Puppets(TWO), judge, [runner], 0, 6)
    assert len(policy.observations) == 3


def test_targets_are_clipped_and_approached_at_the_speed_of_the_expert() -> None:
    _, high = DEFAULT.limits_rad
    executed = commands(lambda seen: np.full((200, 2, 8), 99), steps=200)
    assert np.allclose(executed[-1, :, :7], high) and (executed[..., 7] == 1).all()
    assert np.abs(np.diff(executed[..., :7], axis=0)).max() <= FASTEST_RAD + 1e-9


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda seen: stay(seen)[:, 0], "shape (5, 8); expected finite numbers (T, 2, 8) or (T, 16)"),
        (lambda seen: stay(seen)[0], "actions of shape (2, 8); expected"),
        (lambda seen: np.zeros((0, 2, 8)), "actions of shape (0, 2, 8); expected"),
        (lambda seen: 0.5, "actions of shape (); expected"),
        (lambda seen: None, "actions of type object (NoneType); expected"),
        (lambda seen: stay(seen).astype(str), "actions of type <U32 (ndarray); expected"),
        (lambda seen: stay(seen) > 0, "actions of type bool (ndarray); expected"),
        (lambda seen: stay(seen) * 1j, "actions of type complex64 (ndarray); expected"),
        (lambda seen: [[1.0], [1.0, 2.0]], "actions that are no array (list: setting an array element"),
        (lambda seen: 1 / 0, "it raised ZeroDivisionError: division by zero"),
    ],
)  # fmt: skip
def test_invalid_chunks_are_refused(answer: Answer, message: str) -> None:
    with pytest.raises(StageError, match=re.escape(message)) as refused:
        commands(answer)
    assert str(refused.value).startswith("policy 'theirs', scene 7, control step 0: ")


@pytest.mark.parametrize(("joint", "name"), [(4, "joint 5"), (7, "gripper")])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_named(joint: int, name: str, value: float) -> None:
    def broken(observation: dict[str, Any]) -> NDArray[np.float32]:
        chunk = stay(observation)
        chunk[3, 1, joint] = value
        return chunk

    with pytest.raises(StageError, match=rf"{name} of agent 2 is {value} in step 3 of a chunk of 5"):
        commands(broken)


# -- factories ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("no.such:make", {}, ArgumentError, "'no.such' cannot be imported: ModuleNotFoundError"),
        ("tests.policy.others:other", {}, ArgumentError, "has no function 'other'; it has .*make_stays"),
        ("tests.policy.others:make_raises", {}, StageError, "raised RuntimeError: no checkpoint here"),
        ("tests.policy.others:make_stays", {"hops": 1}, StageError, "raised TypeError: .*'hops'"),
        ("tests.policy.others:make_number", {}, StageError, r"returned a int without act\(observation\)"),
    ],
)
def test_a_factory_that_gives_no_policy_is_an_error(
    name: str, options: dict, error: type, message: str
) -> None:
    with pytest.raises(error, match=message):
        make_policy(name, options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["foreign.name=x"], "one of them; neither is given"),
        (["foreign.name=x", "foreign.factory=a:b", "foreign.server=ws://c:1"], "one of them; both are given"),
        (["foreign.factory=a:b"], "foreign.name is missing"),
        (["foreign.name=../x", "foreign.factory=a:b"], "recipe is '../x'; expected a name for a file"),
        (["foreign.name=x", "foreign.factory=a.b"], "expected package.module:function"),
        (["foreign.name=x", "foreign.server=http://c:1"], "expected ws://host:port"),
        (["foreign.name=x", "foreign.server=ws://me:secret@c"], "holds more than an address"),
        (["foreign.name=x", "foreign.server=ws://c", "foreign.options={a: 1}"], "there is none"),
        (["foreign.name=x", "foreign.server=ws://c", "foreign.answer_s=0"], "foreign.answer_s is 0"),
        (["foreign.name=x", "foreign.server=ws://c", "foreign.observations.state=a"], "state 'a'"),
        (["foreign.name=x", "foreign.server=ws://c", "stages=[train]"], "neither trained nor corrected"),
        (["foreign.name=x", "foreign.server=ws://c", "dagger.rounds=1"], "neither trained nor corrected"),
        (["foreign.name=x", "foreign.server=ws://c", "render=false"], "foreign.observations.pictures=false"),
    ],
)  # fmt: skip
def test_experiments_that_cannot_be_evaluated_are_refused(overrides: list[str], message: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(message)):
        experiment("stages=[evaluate]", *overrides)


@pytest.mark.slow
def test_experiments_name_the_policy_and_its_kind_of_observations() -> None:
    made = experiment("stages=[evaluate]", "arch=all", "foreign.name=x", "foreign.factory=a:b", *BLIND)
    assert [arch.name for arch in made.archs] == ["foreign"] and made.method == "x"
    assert made.foreign is not None and made.foreign.observation == "pictures"
    privileged = replace(made.foreign, observations=Observations(state="full"))
    assert privileged.observation == "state"


# -- servers -----------------------------------------------------------------------------------------


def connect(server: str, spec: Foreign = SPEC) -> Remote:
    return Remote(server, spec.connect_s, spec.answer_s)


@pytest.fixture(scope="module")
def example() -> Iterator[str]:
    """The address of the server in examples/, which serves a policy that holds still."""
    command = [sys.executable, "examples/foreign/serve.py", "tests.policy.others:make_stays", "--port=0"]
    command += ["--options", '{"steps": 4}']
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=ROOT, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        yield running.stdout.readline().split()[-1]
        running.terminate()


def test_a_served_policy_acts_as_a_local_one(example: str, monkeypatch: pytest.MonkeyPatch) -> None:
    remote_world, local_world = Puppets(TWO), Puppets(TWO)
    spec = replace(SPEC, factory=None, server=example)
    rollout(remote_world, judge, foreign_runners(spec, FASTEST_RAD, TWO), 7, 9)
    local, _ = make_runner(lambda seen: stay(seen, 4))
    rollout(local_world, judge, [local], 7, 9)
    assert np.array_equal(remote_world.commands, local_world.commands)


def test_an_error_of_a_served_policy_is_reported_in_one_line(example: str) -> None:
    remote = connect(example)
    with pytest.raises(StageError, match=r"ws://127.0.0.1:\d+ reports an error: KeyError: 'qpos'"):
        remote.act({})


def test_the_first_observation_of_an_episode_tells_a_server_its_seed() -> None:
    received: list[Any] = []

    def converse(connection: Any) -> None:
        connection.send(pack({"checkpoint": "a"}))
        for message in connection:
            received.append(unpack(message))
            connection.send(pack({"actions": np.zeros((1, 2, 8), np.float32), "server_timing": {}}))

    with server(converse) as address:
        remote = connect(address)
        assert remote.metadata == {"checkpoint": "a"}
        picture = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
        for _ in range(2):
            remote.reset(1000003)
            for _ in range(2):
                remote.act({"rgb_global": picture, "language": "lift"})
        remote.close()
    assert [message.get("reset") for message in received] == [1000003, None] * 2
    assert np.array_equal(received[0]["rgb_global"], picture) and received[0]["rgb_global"].dtype == np.uint8
    assert received[0]["language"] == "lift"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("converse", "message"),
    [
        (says("Traceback\nValueError: no weights"), "reports an error: ValueError: no weights"),
        (says(b"\xc1"), "answers with 1 bytes that are no message"),
        (says(pack([1])), "answers with a list; expected a map"),
        (says(pack({}), pack({"action": 1})), "answers with ['action']; expected a map with 'actions'"),
        (says(pack({}), "ValueError: hm"), "reports an error: ValueError: hm"),
        (says(pack({})), "has closed the connection"),
        (silent(greets=False), "gives no answer within 0.5 s (foreign.connect_s)"),
        (silent(greets=True), "gives no answer within 0.3 s (foreign.answer_s)"),
    ],
)
def test_invalid_or_missing_answers_of_a_server_are_errors(converse: Any, message: str) -> None:
    with server(converse) as address, pytest.raises(StageError, match=re.escape(message)):
        remote = Remote(address, 0.5, 0.3)
        remote.reset(0)
        remote.act({"qpos": np.zeros(3)})


def test_a_server_that_is_absent_silent_or_no_websocket() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"ws://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(StageError, match=r"does not answer within 0.2 s \(foreign.connect_s\)"):
            Remote(address, 0.2, 1.0)
    with pytest.raises(StageError, match=r"cannot be reached: .*; start it first"):
        Remote(address, 1.0, 1.0)

    def refuses(connection: Any, request: Any) -> Any:
        return connection.respond(403, "not you")

    with (
        server(says(b""), process_request=refuses) as address,
        pytest.raises(StageError, match=r"refuses the connection: .*403"),
    ):
        Remote(address, 1.0, 1.0)


def test_arrays_are_sent_in_the_format_of_openpi() -> None:
    array = np.arange(6, dtype=np.float32).reshape(2, 3)
    form = {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": "<f4", b"shape": [2, 3]}
    assert msgpack.unpackb(pack({"a": array})) == {"a": form}
    number = {b"__npgeneric__": True, b"data": 3, b"dtype": "<i8"}
    sent = {"a": form, "n": number, "text": "x", "flag": True}
    back = unpack(msgpack.packb(sent) or b"")
    assert np.array_equal(back.pop("a"), array) and back == {"n": 3, "text": "x", "flag": True}


@pytest.mark.parametrize(
    "changed",
    [
        *({b"dtype": "|O"}, {b"dtype": "<f9"}, {b"shape": [2, 4]}),
        *({b"shape": [2**40]}, {b"data": b"1"}, {b"data": 5}),
    ],
)
def test_invalid_arrays_are_refused(changed: dict) -> None:
    form = {b"__ndarray__": True, b"data": bytes(24), b"dtype": "<f4", b"shape": [2, 3], **changed}
    with pytest.raises(ValueError, match="bytes that are no message"):
        unpack(msgpack.packb({"actions": form}) or b"")
    with pytest.raises(TypeError, match="object cannot be sent"):
        pack(np.array([None]))


MANY, FEW = 8_000_000, 4000
SMALL_ITEMS = {
    "a list of lists": b"\xdd" + MANY.to_bytes(4, "big") + b"\x90" * MANY,
    "a map": b"\xdf" + MANY.to_bytes(4, "big") + b"\xa1a\xc0" * (MANY // 3),
    "lists of lists": b"\xdc\x07\xd0" + (b"\xdc\x0f\xa0" + b"\x90" * FEW) * (MANY // FEW),
    "lists in lists": b"\xdc\x0f\xa0" * 500 + b"\x90" * MANY,
    "maps of nothing": b"\xdc\x07\xd0" + (b"\xdc\x0f\xa0" + b"\x80" * FEW) * (MANY // FEW),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", SMALL_ITEMS)
def test_messages_of_millions_of_small_items_are_refused_at_little_cost(what: str) -> None:
    message = b"\x81\xa7actions" + SMALL_ITEMS[what]
    tracemalloc.start()
    began_s = time.process_time()
    with pytest.raises(ValueError, match=r"bytes that are no message: ValueError: .*(items|exceeds max_)"):
        unpack(message)
    cost_s, (_, peak) = time.process_time() - began_s, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert cost_s < 1.0 and peak < 5e7, (cost_s, peak)


def test_a_chunk_of_lists_is_decoded() -> None:
    chunk = np.random.default_rng(0).normal(size=(1500, 32)).tolist()
    assert unpack(pack({"actions": chunk})) == {"actions": chunk}


# -- the stage ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_failing_policy_loses_no_row_and_the_command_resumes(command: Any, tmp_path: Path) -> None:
    mended = tmp_path / "mended"
    arguments = (
        *("task=pick_meat", "stages=[evaluate]", "scenes=3", "recordings=0", "films=0", "wandb=disabled"),
        *("foreign.name=brittle", "foreign.factory=tests.policy.others:make_brittle", "foreign.step_limit=4"),
        "workers=1",
        *(f"foreign.options={{seed: 1000001, mended: {mended}}}", *BLIND, f"out={tmp_path}"),
    )
    broken = command(*arguments)
    assert broken.returncode == 1
    assert "policy 'brittle', scene 1000001, control step 0: it raised ZeroDivisionError" in broken.stderr
    path = tmp_path / "results/evaluate/pick_meat/foreign/full-brittle-0.jsonl"
    assert [row.scene_seed for row in read_rows(path, EvaluationRow)] == [1000000]
    mended.touch()
    assert command(*arguments).returncode == 0
    found = read_rows(path, EvaluationRow)
    assert [row.scene_seed for row in found] == [1000000, 1000001, 1000002]
    assert {(r.arch, r.recipe, r.demos, r.steps, r.success) for r in found} == {
        ("foreign", "brittle", 0, 4, False)
    }
    other = command(*arguments, "foreign.action_steps=2")
    assert other.returncode == 1 and "foreign.action_steps: found " in other.stderr


@pytest.mark.slow
def test_the_step_limit_of_the_task_applies_without_any_demonstration(command: Any, tmp_path: Path) -> None:
    arguments = (
        *("task=pick_meat", "stages=[evaluate]", "scenes=1", "recordings=0", "films=0", "wandb=disabled"),
        *("foreign.name=hold", "foreign.factory=examples.foreign.hold:make", *BLIND, f"out={tmp_path}"),
        "task.pick_meat.step_limit=30",
    )
    assert command(*arguments, "workers=1").returncode == 0
    (row,) = read_rows(tmp_path / "results/evaluate/pick_meat/foreign/full-hold-0.jsonl", EvaluationRow)
    assert row.steps == row.step_limit == 30
