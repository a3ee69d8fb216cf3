"""Requests to language models, their answers, and replay from recordings."""

import base64
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rf_exp.datagen.brain import BadAnswer, Question, ReplaySpec, from_json, to_json
from rf_exp.datagen.brain.chat import read_exchanges
from rf_exp.errors import ArgumentError
from rf_exp.types import Subgoal
from tests.datagen.guard import FULL
from tests.datagen.language.asking import GOOD, KEY, ask, make, openai_spec, scripted_answers
from tests.datagen.language_server import completion, failure
from tests.scenes import rejection, start_scene


@pytest.mark.slow
def test_a_model_makes_an_episode_that_is_repeated_from_its_recording(lift_sim, server, tmp_path):
    task = lift_sim.task
    server.replies = [completion(text) for text in scripted_answers(task)]
    spec = openai_spec(server.url, exchanges=str(tmp_path))
    live = make(lift_sim, spec)
    assert live.success and live.attempts == 1 and len(server.requests) == 3
    assert set(server.keys) == {f"Bearer {KEY}"}

    recorded = read_exchanges((spec.folder or tmp_path) / "lift_barrier" / "full" / "0.jsonl")
    assert [(e.call, e.purpose, e.error) for e in recorded] == [(k, "propose", None) for k in (1, 2, 3)]
    assert recorded[0].reply == scripted_answers(task)[0] and recorded[0].latency_s > 0
    assert [e.verdict for e in recorded] == ["carried out", "carried out", "nothing left"]
    assert {e.finish_reason for e in recorded} == {"stop"} and recorded[0].sampling["temperature"] == 0.0
    assert live.dialogue.calls == 3 and live.dialogue.prompt_tokens == 0  # the server reports none
    again = make(lift_sim, spec.again())
    assert len(server.requests) == 3  # no further request
    assert live.episode is not None and again.episode is not None
    assert again.episode.action.tobytes() == live.episode.action.tobytes()
    assert again.episode.qpos.tobytes() == live.episode.qpos.tobytes()


def test_the_request_holds_scene_pictures_schema_and_feedback(lift_barrier, server):
    server.replies = [completion(scripted_answers(lift_barrier)[0])]
    picture = np.zeros((24, 32, 3), np.uint8)
    picture[:, :, 0] = 255  # red
    question = Question(
        lift_barrier,
        start_scene(lift_barrier, 0),
        {"global": picture, "agent1": picture},
        (Subgoal(1, "grasp", "barrier", "left"),),
        (found := rejection(lift_barrier, "wrong_direction"),),
    )
    openai_spec(server.url).make(lift_barrier, FULL, 0).answer(question)
    (request,) = server.requests
    schema = request["response_format"]["json_schema"]
    assert schema["strict"] is True
    assert set(schema["schema"]["$defs"]["Subgoals"]["properties"]) == {
        "Agent_1",
        "Agent_2",
        "Anybody",
    }
    system, user = request["messages"]
    assert "Agent_1 must grasp barrier at its left point." in system["content"]
    text = user["content"][0]["text"]
    for part in (
        "barrier, point left",
        "Agent_1: grasp barrier at left",
        f"ValidateDirection: {found.sentence}",
    ):
        assert part in text
    labels = [part["text"] for part in user["content"][1:] if part["type"] == "text"]
    assert labels == ["Camera global:", "Camera agent1:"]
    uri = user["content"][2]["image_url"]["url"]
    jpeg = np.frombuffer(base64.b64decode(uri.removeprefix("data:image/jpeg;base64,")), np.uint8)
    sent = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    assert sent is not None
    blue, green, red = sent.reshape(-1, 3).mean(axis=0)
    assert red > 240 and blue < 15 and green < 15


def test_a_request_contains_the_refused_answer_and_its_error(lift_barrier, server):
    first, second, _ = scripted_answers(lift_barrier)
    server.replies = [completion(text) for text in (first, second, first)]
    brain = openai_spec(server.url).make(lift_barrier, FULL, 0)
    question = Question(lift_barrier, start_scene(lift_barrier, 0), {})
    refused = replace(question, feedback=(rejection(lift_barrier, "wrong_direction"),))
    for next_question in (question, refused, question):
        brain.answer(next_question)
    texts = [request["messages"][1]["content"] for request in server.requests]
    assert [first in text for text in texts] == [False, True, False]
    assert second not in texts[2]  # that answer was carried out
    assert "something was wrong with it\nnone\n" in texts[0]


def test_the_parser_reads_what_the_schema_allows(lift_barrier, server):
    """An answer with every kind of entry of the schema becomes a proposal; code fences are removed."""
    entry = {"Agents": ["Agent_1", "Agent_2"], "Constraint": "Agents must avoid colliding with each other."}
    answer = {
        "Subgoals": {"Agent_1": "grasp barrier at left; lift barrier by 0.1 m", "Agent_2": ""},
        "Constraints": {"Logical": [], "Temporal": [], "Spatial": [entry]},
    }
    server.replies = [completion(f"```json\n{json.dumps(answer)}\n```")]
    proposal = from_json(ask(openai_spec(server.url), lift_barrier), lift_barrier)
    assert [s.text for s in proposal.subgoals] == ["grasp barrier at left", "lift barrier by 0.1 m"]
    assert proposal.constraints[0].agents == (1, 2)


def test_enumerated_schemas_list_the_legal_answers_of_the_scene(lift_barrier, server):
    answer = {"Agent_1": ["grasp barrier at left"], "Agent_2": []}
    server.replies = [completion(json.dumps({"Subgoals": answer}))]
    text = ask(openai_spec(server.url, enumerated=True), lift_barrier)
    assert [each.text for each in from_json(text, lift_barrier).subgoals] == ["grasp barrier at left"]
    sent = server.requests[0]["response_format"]["json_schema"]["schema"]["$defs"]["Subgoals"]["properties"]
    assert {*sent} == {"Agent_1", "Agent_2"}
    assert "grasp barrier at left" in sent["Agent_1"]["items"]["enum"]


def test_replay_explains_missing_answers(lift_barrier, server, tmp_path):
    server.replies = [completion(GOOD)]
    spec = openai_spec(server.url, exchanges=str(tmp_path))
    ask(spec, lift_barrier)
    with pytest.raises(BadAnswer, match=r"asks another question than the recording .*now"):
        ask(spec.again(), lift_barrier, previous=(Subgoal(1, "home"),))
    brain, question = (
        spec.again().make(lift_barrier, FULL, 0),
        Question(lift_barrier, start_scene(lift_barrier, 0), {}),
    )
    assert brain.answer(question) == to_json(from_json(GOOD, lift_barrier))
    with pytest.raises(BadAnswer, match="is over after 1 calls"):
        brain.answer(question)
    with pytest.raises(BadAnswer, match=r"there is no recording .*7\.jsonl"):
        spec.again().make(lift_barrier, FULL, 7).answer(question)
    with pytest.raises(ArgumentError, match="there is no folder"):
        ReplaySpec(tmp_path / "elsewhere", True).make(lift_barrier, FULL, 0)


def test_replay_repeats_errors_and_needs_no_pictures(lift_barrier, server, tmp_path):
    server.replies = [failure(500, "boom"), completion(GOOD)]
    spec = openai_spec(server.url, exchanges=str(tmp_path))
    scene = start_scene(lift_barrier, 0)
    with_picture = Question(lift_barrier, scene, {"global": np.zeros((24, 32, 3), np.uint8)})
    live = spec.make(lift_barrier, FULL, 0)
    with pytest.raises(BadAnswer) as first:
        live.answer(with_picture)
    answer = live.answer(with_picture)
    call = json.loads(((spec.folder or tmp_path) / "lift_barrier/full/0.jsonl").read_text().splitlines()[0])
    assert len(call["messages"][1]["pictures_sha256"]["global"]) == 64
    without_picture, replayed = Question(lift_barrier, scene, {}), spec.again().make(lift_barrier, FULL, 0)
    with pytest.raises(BadAnswer, match="500") as second:
        replayed.answer(without_picture)
    assert str(first.value) == str(second.value) and replayed.answer(without_picture) == answer
