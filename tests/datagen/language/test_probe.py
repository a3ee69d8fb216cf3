"""Probe of a server: whether it enforces the JSON schema, reported in one line after one request."""

import json
import socket

import pytest

from rf_exp import doctor
from rf_exp.datagen.brain import from_json, probe
from tests.datagen.language.asking import KEY, openai_spec
from tests.datagen.language_server import Reply, completion, failure

NOTHING = json.dumps(
    {
        "Subgoals": {"Agent_1": "", "Agent_2": "", "Anybody": ""},
        "Constraints": {"Logical": [], "Temporal": [], "Spatial": []},
    }
)
ANOTHER = json.dumps({"Subgoals": {"Agent_1": ""}})  # JSON, but not of the schema
REPLIES = {
    "honoured": (completion(NOTHING), "ok", "honours the JSON schema"),
    "honoured after thinking": (completion(f"<think>Hm.</think>{NOTHING}"), "ok", "honours the JSON schema"),
    "ignored": (
        completion(f"Nothing, {KEY}."),
        "note",
        "ignores the JSON schema; its answer begins 'Nothing",
    ),
    "ignored, cut in the middle of the key": (
        completion(f"{'Nothing, as I said to you before. ' * 2}"[: 60 - len(KEY) // 2] + KEY),
        "note",
        "ignores the JSON schema",
    ),
    "ignored with other JSON": (completion(ANOTHER), "note", "ignores the JSON schema"),
    "refused": (failure(400, f"response_format? {KEY}"), "missing", "refuses a request with the JSON schema"),
    "refused as not there": (failure(501, "no"), "missing", "refuses a request with the JSON schema"),
    "unreachable, another key": (failure(401, f"wrong key {KEY}"), "missing", "the server answered 401"),
    "unreachable, broken": (failure(500, "boom"), "missing", "the server answered 500"),
    "unreachable, busy": (failure(429, "slow down"), "missing", "too many requests"),
    "unreachable, slow": (completion(NOTHING, delay_s=5.0), "missing", "did not answer within 0.3 s"),
    "unreachable, elsewhere": (Reply(b"", 307, {"Location": "http://x.test"}), "missing", "sends on to"),
    "unknown": (completion("{", finish="length"), "note", "the answer is cut off"),
}


def request_timeout_s(kind: str) -> float:
    """Timeout in seconds; long for all other kinds, as a busy machine also answers late."""
    return 0.3 if kind == "unreachable, slow" else 30.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", REPLIES)
def test_one_request_determines_the_handling_of_the_schema(kind, lift_barrier, server):
    reply, _, words = REPLIES[kind]
    server.replies = [reply]
    spec = openai_spec(server.url, timeout_s=request_timeout_s(kind), retries=3, structured=False)
    probed = probe(spec, lift_barrier)
    assert probed.verdict == kind.partition(",")[0].split()[0]
    assert words in probed.message and KEY[:8] not in probed.message and "\n" not in probed.message
    (request,) = server.requests
    assert request["response_format"]["json_schema"]["strict"] is True


def test_no_server_at_the_address(lift_barrier, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with socket.socket() as bound:  # bound but not listening
        bound.bind(("127.0.0.1", 0))
        probed = probe(openai_spec(f"http://127.0.0.1:{bound.getsockname()[1]}/v1"), lift_barrier)
    assert probed.verdict == "unreachable" and "ConnectError" in probed.message


def test_the_answer_of_the_probe_is_a_valid_answer(lift_barrier):
    assert from_json(NOTHING, lift_barrier).subgoals == ()


@pytest.mark.slow
@pytest.mark.parametrize("kind", REPLIES)
def test_the_doctor_reports_it_in_one_line(kind, server, monkeypatch):
    reply, state, words = REPLIES[kind]
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    server.replies = [reply]
    timeout_s = f"brain.timeout_s={request_timeout_s(kind)}"
    check = doctor.brain(["brain=openai", f"brain.base_url={server.url}", timeout_s])
    assert (check.name, check.state) == ("brain", state) and words in check.detail
    assert bool(check.remedy) == (state != "ok") and KEY not in str(check)
    assert len(server.requests) == 1


def test_a_server_that_refuses_the_schema_is_accepted_if_none_is_sent(server):
    server.replies = [failure(400, "no")]
    overrides = ["brain=openai", f"brain.base_url={server.url}", "brain.structured=false"]
    assert doctor.brain(overrides).state == "note"


@pytest.mark.parametrize(
    ("overrides", "state", "words"),
    [
        (["brain=scripted"], "ok", "scripted asks no server"),
        (["brain=nobody"], "missing", "Could not find 'brain/nobody' Available options"),
        (["brain=openai", "brain.extra_body=3"], "missing", "brain.extra_body is 3"),
        (["brain=openai", "brain.cameras=left"], "missing", "available: all, global, local"),
        ([f"brain.api_key={KEY}"], "missing", "environment variable"),
        (["brain.extra_body={api_key: " + KEY + "}"], "missing", "environment variable"),
    ],
)
def test_an_impossible_brain_is_reported_without_a_request(overrides, state, words):
    check = doctor.brain(overrides)
    assert check.state == state and words in check.detail
    assert KEY not in str(check) and "\n" not in str(check)
