"""Errors between a question and its proposal: transport, format and content of answers."""

import gzip
import json
import re
import socket
import time
from types import SimpleNamespace

import pytest

from rf_exp.datagen.brain import BadAnswer, Question, chat, from_json
from rf_exp.datagen.brain.chat import read_exchanges
from rf_exp.datagen.brain.request import MAX_BODY_BYTES, parse_completion
from rf_exp.findings import Finding
from rf_exp.types import Subgoal
from tests.datagen.guard import FULL
from tests.datagen.language.asking import GOOD, KEY, ask, make, openai_spec, scripted_answers
from tests.datagen.language_server import Reply, completion, failure
from tests.scenes import start_scene

BAD = {
    "wrong JSON": (completion("Sure! Here is the plan: {"), "not the expected JSON"),
    "wrong schema": (completion('{"Subgoals": ["grasp"]}'), "Subgoals"),
    "unknown agent": (completion('{"Subgoals": {"Agent_5": "hold"}}'), "unknown agent 'Agent_5'"),
    "refused by the model": (
        completion(None, refusal="I cannot help with that."),
        "the model refuses: I can",
    ),
    "cut off": (completion(GOOD[:20], finish="length"), "cut off"),
    "filtered": (completion("", finish="content_filter"), "content filter"),
    "empty": (completion(""), "the answer is empty"),
    "no choices": (Reply(b'{"choices": []}'), "not a chat completion"),
    "no completion": (Reply(b"<html>gateway</html>", headers={"Content-Type": "text/html"}), "<html>gateway"),
    "connection closed half-way": (completion(GOOD, cut_after=40), "not reached: RemoteProtocolError"),
    "not UTF-8": (Reply(b'{"choices": "\xff\xfe"}'), "not a chat completion"),
    "bad compression": (completion(GOOD, headers={"Content-Encoding": "gzip"}), "cannot be unpacked: Error"),
    "cut compression": (
        Reply(gzip.compress(completion(GOOD).body)[:-9], headers={"Content-Encoding": "gzip"}),
        "cannot be unpacked: it is cut off",
    ),
    "compressed twice": (
        Reply(
            gzip.compress(gzip.compress(completion(GOOD).body)), headers={"Content-Encoding": "gzip, gzip"}
        ),
        "the answer is packed as 'gzip, gzip'; asked for was gzip or nothing",
    ),
    "too long": (
        completion(" " * MAX_BODY_BYTES),
        f"longer than {MAX_BODY_BYTES} bytes; the rest was not read",
    ),
    "a long error": (Reply(b"x" * (MAX_BODY_BYTES + 1), 400), f"longer than {MAX_BODY_BYTES} bytes"),
    "sent on": (
        Reply(b"", 307, {"Location": "http://elsewhere.test/v1?\x1b[2J"}),
        "the server answered 307 and sends on to 'http://elsewhere.test/v1",
    ),
    "another type": (
        Reply(b"\x89PNG", headers={"Content-Type": "image/png"}),
        "it is image/png and begins '\ufffdPNG'",
    ),
    "events": (
        Reply(b'data: {"choices": []}', headers={"Content-Type": "text/event-stream"}),
        "it is text/event-stream and begins 'data: {",
    ),
    "parts without text": (completion([{"type": "image_url"}]), "empty, but for parts that are image_url"),
    "refused in a part": (completion([{"type": "refusal", "refusal": "No."}]), "the model refuses: No."),
    "thinking only": (
        completion(None, more={"reasoning_content": "The barrier is long."}),
        "the answer is thinking only: it has no text",
    ),
    "thinking only, in a part": (
        completion([{"type": "thinking", "thinking": "The barrier is long."}]),
        "the answer is thinking only: it has no text",
    ),
    "thinking that ends in JSON of another kind": (
        completion(None, more={"reasoning_content": 'Say {"plan": 1}.'}),
        "the answer is not the expected JSON: its JSON lacks 'Subgoals'; it holds 'plan'",
    ),
    "two answers, where it thinks": (
        completion(None, more={"reasoning_content": GOOD + GOOD.replace("hold", "home")}),
        "the answer holds 2 different objects with 'Subgoals'; send one",
    ),
    "a tool call without arguments": (
        completion("", more={"tool_calls": [{"type": "function", "function": {"name": "answer"}}]}),
        "the answer is a tool call without arguments",
    ),
    "prose": (completion("Both arms grasp the barrier."), "only text that begins 'Both arms grasp"),
    "slow": (completion(GOOD, delay_s=5.0), "did not answer within 0.3 s"),
    "trickling": (completion(GOOD, drip_s=0.2), "did not answer within 1 s"),
    "wrong key": (failure(401, f"Incorrect API key provided: {KEY}"), "the server answered 401"),
    "server error": (failure(500, "boom"), "the server answered 500"),
    "rate-limited": (failure(429, "slow down"), "too many requests"),
    "deep nesting": (completion("[" * 100_000), "not the expected JSON"),
    "huge number": (completion('{"Subgoals": {"Agent_1": 1e999999}}'), "not the expected JSON"),
}


CALL = {"type": "function", "function": {"name": "answer", "arguments": GOOD}}
READ = {
    "parts": completion([{"type": "reasoning", "text": "Hm."}, {"type": "text", "text": GOOD}, "Done."]),
    "a tool call": completion(None, more={"tool_calls": [CALL]}, finish="tool_calls"),
    "a tool call beside prose": completion("I call it.", more={"tool_calls": [CALL]}),
    "a tool call with an object": completion(
        "", more={"tool_calls": [{"function": {"name": "answer", "arguments": json.loads(GOOD)}}]}
    ),
    "a function call": completion(None, more={"function_call": CALL["function"]}),
    "after thinking": completion(GOOD, more={"reasoning_content": "Hm.", "annotations": []}),
    "where others think, with null": completion(None, more={"reasoning_content": GOOD}),
    "where others think, with nothing": completion(" ", more={"reasoning": f"Hm.\n{GOOD}"}),
    "where others think, twice": completion(None, more={"reasoning": GOOD, "reasoning_content": GOOD}),
    "where others think, after it": completion(None, more={"reasoning_content": f"Hm.</think>{GOOD}"}),
    "a part that others think in": completion([{"type": "thinking", "thinking": GOOD}]),
    "after a draft in thinking": completion(GOOD, more={"reasoning_content": GOOD.replace("hold", "home")}),
    "compressed": Reply(gzip.compress(completion(GOOD).body), headers={"Content-Encoding": "gzip"}),
    "another type and charset": completion(GOOD, headers={"Content-Type": "text/plain; charset=zlib"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("way", READ)
def test_the_text_is_found_in_every_kind_of_completion(way, lift_barrier, server):
    server.replies = [READ[way]]
    assert from_json(ask(openai_spec(server.url), lift_barrier), lift_barrier).subgoals == (
        Subgoal(1, "hold"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", BAD)
def test_an_invalid_answer_is_explained(kind, lift_barrier, server):
    bad, reason = BAD[kind]
    server.replies = [bad]
    with pytest.raises(BadAnswer, match=re.escape(reason)):
        from_json(ask(openai_spec(server.url, timeout_s=0.3, deadline_s=1.0), lift_barrier), lift_barrier)


@pytest.mark.slow
@pytest.mark.parametrize("kind", BAD)
def test_an_invalid_answer_is_repaired_by_the_next_one(kind, lift_sim, server, tmp_path):
    """A bad answer, then valid ones: the second request contains the error, and the episode succeeds."""
    bad, reason = BAD[kind]
    server.replies = [bad, *(completion(text) for text in scripted_answers(lift_sim.task))]
    spec = openai_spec(server.url, timeout_s=0.3, deadline_s=1.0, exchanges=str(tmp_path))
    outcome = make(lift_sim, spec)
    assert outcome.success and outcome.attempts == 2
    exchanges = read_exchanges((spec.folder or tmp_path) / "lift_barrier" / "full" / "0.jsonl")
    assert reason in str(exchanges[1].messages[1]["text"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wrong JSON", "refused by the model", "connection closed half-way"])
def test_repeated_invalid_answers_end_with_their_reason(kind, lift_sim, server):
    bad, reason = BAD[kind]
    server.replies = [bad]
    outcome = make(lift_sim, openai_spec(server.url), attempts=2)
    assert not outcome.success and outcome.attempts == 2 and reason in outcome.reason


def test_a_missing_server_is_reported(lift_sim, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with socket.socket() as bound:  # bound but not listening: connections are refused
        bound.bind(("127.0.0.1", 0))
        spec = openai_spec(f"http://127.0.0.1:{bound.getsockname()[1]}/v1")
        outcome = make(lift_sim, spec, attempts=2)
    assert not outcome.success and "the model was not reached: ConnectError" in outcome.reason


@pytest.mark.slow
def test_too_many_requests_waits_as_long_as_the_server_says(lift_barrier, server):
    limited = failure(429, "slow down", **{"Retry-After": "0.7"})
    server.replies = [limited, completion(GOOD)]
    assert from_json(ask(openai_spec(server.url, retries=1), lift_barrier), lift_barrier).subgoals
    first, second = server.times_s
    assert second - first >= 0.7


@pytest.mark.slow
def test_calls_keep_their_interval_and_their_budget(lift_barrier, server, monkeypatch):
    slept: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: 100.0, sleep=slept.append, perf_counter=time.perf_counter)
    monkeypatch.setattr(chat, "time", clock)
    monkeypatch.setattr(chat.OpenAIChat, "_free_at_s", 0.0)
    server.replies = [completion(GOOD)]
    brain = openai_spec(server.url, min_interval_s=0.4, budget=2).make(lift_barrier, FULL, 0)
    question = Question(lift_barrier, start_scene(lift_barrier, 0), {})
    brain.answer(question)
    assert not slept
    brain.answer(question)
    assert slept == [pytest.approx(0.4)]
    with pytest.raises(BadAnswer, match="the budget of 2 calls is used up"):
        brain.answer(question)
    assert len(server.requests) == 2


LISTS = b"[" + b"[]," * (MAX_BODY_BYTES // 3 - 100) + b"[]]"  # as many lists as fit into a body


@pytest.mark.slow
@pytest.mark.parametrize(
    "body",
    [
        b'{"choices": ' + LISTS + b"}",
        b'{"choices": [{"message": {"tool_calls": ' + LISTS + b"}}]}",
        b'{"choices": [{"message": {"tool_calls": ' + LISTS.replace(b"[],", b"{},") + b"}}]}",
    ],
)
def test_one_of_many_invalid_entries_is_reported_quickly(body: bytes) -> None:
    began_s = time.process_time()
    with pytest.raises(BadAnswer, match="the server's answer is not a chat completion: "):
        parse_completion(body, "application/json")
    assert time.process_time() - began_s < 0.8


def test_one_of_many_invalid_agents_is_reported(lift_barrier) -> None:
    entry = {"Agents": [[]] * 60_000, "Constraint": "x"}
    answer = {"Subgoals": {"Agent_1": "hold"}, "Constraints": {"Logical": [entry]}}
    with pytest.raises(BadAnswer) as caught:
        from_json(json.dumps(answer, separators=(",", ":")), lift_barrier)
    assert str(caught.value).endswith("Constraints.Logical.0.Agents.0: Input should be a valid string")


@pytest.mark.parametrize(
    ("usage", "told"),
    [
        ({"prompt_tokens": 7, "completion_tokens": 3, "total_tokens": 10}, (7, 3)),
        ({"prompt_tokens": 7}, (7, 0)),
        ({"prompt_tokens": -1}, None),
        ("many", None),
        (None, None),
    ],
)
def test_token_counts_are_those_of_the_server(usage, told):
    choice = {"message": {"content": GOOD[:9]}, "finish_reason": "length"}
    found = parse_completion(json.dumps({"choices": [choice], "usage": usage}).encode(), "application/json")
    assert (found.usage and (found.usage.prompt_tokens, found.usage.completion_tokens)) == told
    assert found.finish_reason == "length"
    with pytest.raises(BadAnswer, match="cut off") as cut:  # unusable, but its tokens are counted
        _ = found.text
    assert cut.value.finding is Finding.CUT_OFF
