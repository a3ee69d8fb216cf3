"""Servers that mean harm: what they cost in memory and time, measured in a process of its own."""

import gzip
import json
import random
import subprocess
import sys
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack

import pytest

from rf_exp.datagen.brain import Question, ScriptedBrain
from rf_exp.datagen.brain.request import MAX_BODY_BYTES
from tests.conftest import read_task
from tests.datagen.language_server import LanguageServer, Reply, completion
from tests.scenes import start_scene

MOST_MB = 1000
DEADLINE_S = 2.0
PATIENCE_S = 60.0
SPARE_S = 3.0  # for a busy machine; without the deadline each of these would go on for ever
GOOD = '{"Subgoals": {"Agent_1": "hold"}}'
PACKED = {"Content-Encoding": "gzip"}


def bomb(of_bytes: int) -> bytes:
    """A gzip stream of zeros, a thousandth of the size; pieces that are flushed whole repeat."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    piece = bytes(2**24)
    first = packer.compress(piece) + packer.flush(zlib.Z_FULL_FLUSH)
    again = packer.compress(piece) + packer.flush(zlib.Z_FULL_FLUSH)
    return first + again * (of_bytes // len(piece))


LONG = f"longer than {MAX_BODY_BYTES} bytes"
LATE = f"did not answer within {DEADLINE_S:g} s"


def hostile() -> dict[str, tuple[Reply, str]]:
    """Name -> what the server sends, and what is to be in the reason."""
    zeros, good, twice = bomb(2 * 2**30), gzip.compress(completion(GOOD).body), "gzip, gzip"
    return {
        "a bomb of 2 GB": (Reply(zeros, headers=PACKED), LONG),
        "a bomb of 2 GB in an error": (Reply(zeros, 500, PACKED), LONG),
        "a bomb in a bomb": (Reply(gzip.compress(zeros), headers={"Content-Encoding": twice}), "packed as"),
        "a bomb by its charset": (
            Reply(zlib.compress(bytes(2**29)), 400, {"Content-Type": "text/plain; charset=zlib"}), "400",
        ),
        "a body without end": (Reply(b"{", endless=b" " * 2**16), LONG),
        "an error without end": (Reply(b"{", 400, endless=b" " * 2**16), LONG),
        "empty blocks without end": (
            Reply(gzip.compress(b"")[:10], headers=PACKED, endless=b"\x00\x00\x00\xff\xff" * 2**12), LONG,
        ),
        "headers without end": (Reply(b"", headers={"X": "y" * 2**24}), "the model was not reached"),
        "drop by drop": (completion(GOOD, drip_s=0.3), LATE),
        "drop by drop, packed": (Reply(good, headers=PACKED, drip_s=0.3), LATE),
        "silence": (completion(GOOD, delay_s=60.0), LATE),
        "come back in a year": (Reply(b"{}", 429, {"Retry-After": "31536000"}), "too many requests"),
        "depth": (Reply(b'{"choices":' * 90_000), "not a chat completion"),
        "small things": (Reply(b'{"choices": [' + b"[]," * 300_000), "not a chat completion"),
        "a long text": (completion("[" * 10**6), "an answer has up to"),
        "many objects": (completion('{"a":1}' * 28_000), "lacks 'Subgoals'"),
        "many braces": (completion('{"' * 90_000), "not the expected JSON"),
    }  # fmt: skip


def asked(replies: Mapping[str, list[Reply]], deadlines_s: Sequence[float]) -> dict:
    """What the process tells that asks each of these servers for all of its replies, a sound one first."""
    with ExitStack() as running:
        sound = running.enter_context(LanguageServer([completion(GOOD)]))
        servers = [running.enter_context(LanguageServer(each)) for each in replies.values()]
        jobs = [(sound.url, 3, PATIENCE_S)]
        jobs += [(s.url, len(s.replies), t) for s, t in zip(servers, deadlines_s, strict=True)]
        done = subprocess.run(
            [sys.executable, "-m", "tests.datagen.hostile_client"],
            input=json.dumps(jobs), capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    told["outcomes"] = told["outcomes"][3:]
    return told


@pytest.mark.slow
def test_hostile_servers_cost_neither_memory_nor_time():
    # Who is to be stopped by the limit on bytes has time enough to fill the memory without it.
    servers = hostile()
    deadlines_s = [DEADLINE_S if reason == LATE else PATIENCE_S for _, reason in servers.values()]
    told = asked({name: [reply] for name, (reply, _) in servers.items()}, deadlines_s)
    for (name, (_, reason)), outcome in zip(servers.items(), told["outcomes"], strict=True):
        assert reason in outcome["reason"], (name, outcome)
        assert outcome["wall_s"] < DEADLINE_S + SPARE_S, (name, outcome)
    assert told["peak_mb"] < MOST_MB
    print(f"peak {told['peak_mb']:.0f} MB, longest {max(o['wall_s'] for o in told['outcomes']):.1f} s")


def fuzzed(count: int) -> list[Reply]:
    """Sound completions of a sound answer with bytes of them changed, left out, doubled; some packed."""
    draw, task = random.Random(0), read_task("lift_barrier")
    sound = ScriptedBrain().answer(Question(task, start_scene(task, 0), {}))
    found = []
    for _ in range(count):
        text = _fuzzed(sound.encode(), draw, draw.randrange(3)).decode("utf-8", "replace")
        wrapped = draw.choice(
            ["{}", "Here: {}", "```json\n{}\n```", "<think>{}", "<think></think>{}"]
        ).replace("{}", text)
        more = {"tool_calls": [{"function": {"arguments": wrapped}}]} if draw.random() < 0.2 else {}
        body = _fuzzed(completion(wrapped, more=more).body, draw, draw.randrange(3))
        packed = draw.random() < 0.2
        body = _fuzzed(gzip.compress(body), draw, draw.randrange(2)) if packed else body
        found.append(Reply(body, headers=PACKED if packed else {}))
    return found


def _fuzzed(body: bytes, draw: random.Random, changes: int) -> bytes:
    for _ in range(changes):
        at, length = draw.randrange(len(body)), draw.randrange(1, 40)
        by = draw.choice(
            [b"", draw.randbytes(length), body[at : at + length] * 2, b'"}]{[":,\\'[: length % 9]]
        )
        body = body[:at] + by + body[at + length :]
    return body or b" "


@pytest.mark.slow
def test_fuzzed_replies_are_understood_or_refused_and_nothing_is_executed():
    told = asked({"fuzzed": fuzzed(200)}, [DEADLINE_S])
    reasons = [outcome["reason"] for outcome in told["outcomes"]]
    assert len(reasons) == 200 and all(reasons)
    assert 10 < reasons.count("understood") < 190  # neither all nor nothing gets through
    assert told["peak_mb"] < MOST_MB
    assert max(outcome["wall_s"] for outcome in told["outcomes"]) < DEADLINE_S + SPARE_S
    print(
        f"peak {told['peak_mb']:.0f} MB, understood {reasons.count('understood')}, kinds {len(set(reasons))}"
    )
