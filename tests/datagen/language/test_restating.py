"""Restating of constraints that the grammar does not understand."""

import json

import pytest

from rf_exp.constraints import RoboChecker
from rf_exp.datagen.brain import from_json
from rf_exp.errors import ArgumentError
from tests.datagen.guard import FULL
from tests.datagen.language.asking import ask, make, openai_spec, scripted_answers
from tests.datagen.language_server import completion


def unclear_answer(task):
    """The first scripted answer with two constraints that the grammar does not understand."""
    answer = json.loads(scripted_answers(task)[0])
    answer["Constraints"]["Logical"][0]["Constraint"] = "Agent_1 had better seize the left tip of barrier."
    answer["Constraints"]["Spatial"][0]["Constraint"] = "Agent_1 keeps its distance from its fellows."
    return json.dumps(answer)


@pytest.mark.slow
def test_unclear_constraints_are_restated_in_one_call_and_recorded(lift_sim, server, tmp_path):
    task = lift_sim.task
    restated = [
        "Agent_1 must grasp barrier at its left point.",
        "Avoid collision between Agent_1 and other agents.",
    ]
    replies = [unclear_answer(task), json.dumps({"Sentences": restated}), *scripted_answers(task)[1:]]
    server.replies = [completion(text) for text in replies]
    spec = openai_spec(server.url, exchanges=str(tmp_path))
    live = make(lift_sim, spec)
    assert live.success and live.attempts == 1
    assert "1. Agent_1 had better seize" in server.requests[1]["messages"][1]["content"]
    assert live.episode is not None
    rounds = json.loads(json.dumps(live.episode.certificate))["rounds"]
    assert "VI(Agent_1, barrier, left)" in rounds[0]["check_code"]
    again = make(lift_sim, spec.again())
    assert again.success and len(server.requests) == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "sentences",
    [
        '{"Sentences": []}',
        "no json",
        '{"Sentences": ["Agent_7 must finish within 1 s.", "Agent_1 must grasp lamp at its left point."]}',
        '{"Sentences": ["import os", "Agent_1 rules."]}',
    ],
)
def test_failed_restating_leaves_the_constraint_to_be_refused_by_the_checker(sentences, lift_barrier, server):
    server.replies = [completion(unclear_answer(lift_barrier)), completion(sentences)]
    proposal = from_json(ask(openai_spec(server.url), lift_barrier), lift_barrier)
    assert proposal == from_json(unclear_answer(lift_barrier), lift_barrier)
    with pytest.raises(ArgumentError, match="seize the left tip"):
        RoboChecker(lift_barrier, proposal, FULL)
