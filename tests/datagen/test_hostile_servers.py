"""Hostile servers: the memory and time that they cost, measured in a separate process."""

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
SPARE_S = 3.0  # for a busy machine; without the deadline these replies would never end
GOOD = '{"Subgoals": {"Agent_1": "hold"}}'
PACKED = {"Content-Encoding": "gzip"}


def bomb(of_bytes: int) -> bytes:
    """Gzip stream of zeros, a thousandth of their size; one fully flushed block is repeated."""
    compressor = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    piece = bytes(2**24)
    first = compressor.compress(piece) + compressor.flush(zlib.Z_FULL_FLUSH)
    again = compressor.compress(piece) + compressor.flush(zlib.Z_FULL_FLUSH)
    return first + again * (of_bytes // len(piece))


LONG = f"longer than {MAX_BODY_BYTES} bytes"
LATE = f"did not answer within {DEADLINE_S:g} s"


def hostile() -> dict[str, tuple[Reply, str]]:
    """Name -> (reply of the server, expected part of the error message)."""
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


def run_client(replies: Mapping[str, list[Reply]], deadlines_s: Sequence[float]) -> dict:
    """Result of the process that requests all replies of each server, after those of a valid server."""
    with ExitStack() as running:
        valid = running.enter_context(LanguageServer([completion(GOOD)]))
        servers = [running.enter_context(LanguageServer(each)) for each in replies.values()]
        jobs = [(valid.url, 3, PATIENCE_S)]
        jobs += [(s.url, len(s.replies), t) for s, t in zip(servers, deadlines_s, strict=True)]
        done = subprocess.run(
            [sys.executable, "-m", "tests.datagen.hostile_client"],
            input=json.dumps(jobs), capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-2000:]
    stats = json.loads(done.stdout.splitlines()[-1])
    stats["outcomes"] = stats["outcomes"][3:]
    return stats


@pytest.mark.slow
def test_hostile_servers_cost_neither_memory_nor_time():
    # Where the byte limit has to stop a reply, the deadline is long enough to fill the memory without it.
    servers = hostile()
    deadlines_s = [DEADLINE_S if reason == LATE else PATIENCE_S for _, reason in servers.values()]
    stats = run_client({name: [reply] for name, (reply, _) in servers.items()}, deadlines_s)
    for (name, (_, reason)), outcome in zip(servers.items(), stats["outcomes"], strict=True):
        assert reason in outcome["reason"], (name, outcome)
        assert outcome["wall_s"] < DEADLINE_S + SPARE_S, (name, outcome)
    assert stats["peak_mb"] < MOST_MB
    print(f"peak {stats['peak_mb']:.0f} MB, longest {max(o['wall_s'] for o in stats['outcomes']):.1f} s")


def fuzzed(count: int) -> list[Reply]:
    """Valid completions of a valid answer with bytes changed, removed or duplicated; some are compressed."""
    draw, task = random.Random(0), read_task("lift_barrier")
    valid = ScriptedBrain().answer(Question(task, start_scene(task, 0), {}))
    found = []
    for _ in range(count):
        text = _fuzzed(valid.encode(), draw, draw.randrange(3)).decode("utf-8", "replace")
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
        replacement = draw.choice(
            [b"", draw.randbytes(length), body[at : at + length] * 2, b'"}]{[":,\\'[: length % 9]]
        )
        body = body[:at] + replacement + body[at + length :]
    return body or b" "


@pytest.mark.slow
def test_fuzzed_replies_are_understood_or_refused_and_nothing_is_executed():
    stats = run_client({"fuzzed": fuzzed(200)}, [DEADLINE_S])
    reasons = [outcome["reason"] for outcome in stats["outcomes"]]
    assert len(reasons) == 200 and all(reasons)
    assert 10 < reasons.count("understood") < 190  # some answers are understood, and some are not
    assert stats["peak_mb"] < MOST_MB
    assert max(outcome["wall_s"] for outcome in stats["outcomes"]) < DEADLINE_S + SPARE_S
    print(
        f"peak {stats['peak_mb']:.0f} MB, understood {reasons.count('understood')}, kinds {len(set(reasons))}"
    )
