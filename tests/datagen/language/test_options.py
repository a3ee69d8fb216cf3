"""Options for the server and choice of pictures: in requests, in the identity, and their errors."""

import base64

import cv2
import numpy as np
import pytest

from rf_exp.datagen.brain import Question
from rf_exp.datagen.brain.chat import REQUEST_FIELDS
from rf_exp.errors import ArgumentError
from tests.conftest import experiment
from tests.datagen.guard import FULL
from tests.datagen.language.asking import GOOD, KEY, ask, openai_spec
from tests.datagen.language_server import completion
from tests.scenes import start_scene

NO_THINKING = {"chat_template_kwargs": {"enable_thinking": False}, "top_k": 20, "max_tokens": 4000}
MODEL, GENERATE = "brain=openai", "stages=[generate]"


def test_the_servers_own_options_are_in_every_request_and_in_the_identity(lift_barrier, server):
    server.replies = [completion(GOOD)]
    spec = openai_spec(server.url, extra_body=NO_THINKING)
    ask(spec, lift_barrier)
    (request,) = server.requests
    assert {name: request.pop(name) for name in NO_THINKING} == NO_THINKING
    assert set(request) <= set(REQUEST_FIELDS)
    assert spec.identity["extra_body"] == NO_THINKING


def test_unused_options_are_not_in_the_identity():
    assert not {"extra_body", "cameras", "picture_px"} & set(openai_spec(None).identity)
    assert openai_spec(None, cameras="global", picture_px=64).identity.items() >= {
        ("cameras", "global"),
        ("picture_px", 64),
    }


@pytest.mark.parametrize("name", REQUEST_FIELDS)
def test_fields_of_requests_cannot_be_overridden(name):
    with pytest.raises(
        ArgumentError, match=rf"extra_body holds '{name}', .* possible here .*enable_thinking"
    ):
        openai_spec(None, extra_body={"top_k": 20, name: None})


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"extra_body": 3}, "brain.extra_body is 3; expected a mapping"),
        ({"extra_body": ["top_k"]}, r"brain.extra_body is \['top_k'\]; expected a mapping"),
        ({"extra_body": {"top_p": float("nan")}}, "expected values that JSON has"),
        ({"extra_body": {"a": [{"API_key": KEY}]}}, "is not taken: configurations are written"),
        ({"cameras": "left"}, "unknown brain.cameras 'left'; available: all, global, local"),
        ({"cameras": "left", "pictures": False}, "unknown brain.cameras 'left'"),
        ({"picture_px": 0}, "brain.picture_px is 0; possible are 16 to 2048 pixels"),
        ({"picture_px": 4096}, "brain.picture_px is 4096; possible are 16 to 2048 pixels"),
        ({"picture_px": "big"}, "picture_px"),
    ],
)
def test_impossible_options_are_refused_with_the_possible_ones(changes, reason):
    with pytest.raises(ArgumentError, match=reason) as refused:
        openai_spec(None, **changes)
    assert KEY not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (["brain.cameras=left"], "unknown brain.cameras 'left'"),
        (["brain.extra_body={model: other}"], "brain.extra_body holds 'model'"),
        (["brain.cameras=local", "cameras=global"], "cameras=global takes other pictures; use cameras=all"),
        (["brain.cameras=global", "render=false"], "render=false takes no pictures; use render=true"),
    ],
)
def test_a_run_without_the_requested_pictures_is_refused(overrides, reason):
    with pytest.raises(ArgumentError, match=reason):
        experiment(MODEL, *overrides)


@pytest.mark.slow
def test_available_cameras_are_accepted():
    """The defaults, with and without pictures, and cameras that are a subset of the rendered ones."""
    experiment(MODEL, GENERATE, "render=false")
    experiment(MODEL, "cameras=local")
    experiment(MODEL, "brain.cameras=local", "cameras=local")
    experiment(MODEL, "brain.cameras=global", "brain.pictures=false", "render=false", GENERATE)


@pytest.mark.parametrize(
    ("changes", "cameras", "size"),
    [
        ({}, ["global", "agent1", "agent2"], (24, 32)),
        ({"cameras": "global"}, ["global"], (24, 32)),
        ({"cameras": "local", "picture_px": 16}, ["agent1", "agent2"], (12, 16)),
        ({"picture_px": 64}, ["global", "agent1", "agent2"], (48, 64)),
        ({"pictures": False}, [], None),
    ],
)
def test_the_chosen_cameras_are_sent_at_the_chosen_size(changes, cameras, size, lift_barrier, server):
    server.replies = [completion(GOOD)]
    pictures = {name: np.zeros((24, 32, 3), np.uint8) for name in lift_barrier.cameras}
    question = Question(lift_barrier, start_scene(lift_barrier, 0), pictures)
    openai_spec(server.url, **changes).make(lift_barrier, FULL, 0).answer(question)
    content = server.requests[0]["messages"][1]["content"]
    parts = [] if isinstance(content, str) else content[1:]
    labels = [part["text"] for part in parts if part["type"] == "text"]
    assert labels == [f"Camera {name}:" for name in cameras]
    for part in parts[1::2]:
        jpeg = base64.b64decode(part["image_url"]["url"].partition(",")[2])
        sent = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert sent is not None and sent.shape[:2] == size
