"""API keys stay in the environment: not in files, messages or requests to other servers."""

import json
import pickle
from pathlib import Path

import pytest

from rf_exp.datagen.brain import BadAnswer
from rf_exp.errors import ArgumentError
from tests.datagen.guard import FULL
from tests.datagen.language.asking import GOOD, KEY, ask, make, openai_spec, scripted_answers
from tests.datagen.language_server import LanguageServer, Reply, completion, failure


def files_containing(folder: Path, text: str) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and text.encode() in path.read_bytes()]


@pytest.mark.slow
def test_the_key_is_in_no_file_and_no_reason(lift_sim, server, tmp_path):
    """Also where the server repeats the key in errors or answers."""
    task = lift_sim.task
    server.replies = [
        failure(401, f"Incorrect API key provided: {KEY}. Header: Bearer {KEY}"),
        completion(f"The key is {KEY}."),
        completion(None, refusal=f"I refuse {KEY}"),
        *(completion(text) for text in scripted_answers(task)),
    ]
    spec = openai_spec(server.url, exchanges=str(tmp_path))
    outcome = make(lift_sim, spec)
    assert outcome.success and outcome.attempts == 4
    assert KEY.encode() not in pickle.dumps(spec) and KEY not in json.dumps(dict(spec.identity))
    assert outcome.episode is not None and KEY not in json.dumps(dict(outcome.episode.certificate))
    assert (
        files_containing(tmp_path, "[key]")
        and not files_containing(tmp_path, KEY)
        and not files_containing(tmp_path, KEY[3:])
    )


def test_a_key_is_needed_only_where_no_address_is_given(lift_barrier, monkeypatch, server):
    monkeypatch.delenv("TEST_KEY")
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)
    with pytest.raises(ArgumentError, match="needs a key in the environment variable TEST_KEY"):
        openai_spec(None).make(lift_barrier, FULL, 0)
    server.replies = [completion(GOOD)]
    monkeypatch.setenv("OPENAI_BASE_URL", server.url)
    assert ask(openai_spec(None), lift_barrier) and server.keys == ["Bearer none"]


@pytest.mark.slow
@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_redirects_are_not_followed(status, lift_barrier, server):
    with LanguageServer([completion(GOOD)]) as other:
        server.replies = [Reply(b"", status, {"Location": f"{other.url}/chat/completions"})]
        with pytest.raises(BadAnswer, match=f"answered {status} and sends on to '{other.url}"):
            ask(openai_spec(server.url), lift_barrier)
        assert len(server.requests) == 1 and not other.requests and not other.keys
