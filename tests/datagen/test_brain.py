"""The paper's JSON: round trip, and every way in which an answer can be wrong."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rf_exp.datagen.brain import BadAnswer, Question, from_json, make_brain, to_json
from rf_exp.datagen.brain.protocol import parse_subgoal
from rf_exp.errors import ArgumentError
from rf_exp.types import Proposal
from tests.conftest import read_task
from tests.scenes import start_scene


def test_scripted_plan_survives_the_round_trip(task):
    scene = start_scene(task, 0)
    text = make_brain("scripted").answer(Question(task, scene, {}))
    proposal = from_json(text, task)
    assert proposal == task.module.plan(scene, task)
    assert to_json(proposal) == text
    assert {subgoal.agent for subgoal in proposal.subgoals} <= set(task.agents)


def test_answer_has_the_papers_structure(lift_barrier):
    answer = json.loads(
        make_brain("scripted").answer(Question(lift_barrier, start_scene(lift_barrier, 0), {}))
    )
    assert answer["Subgoals"]["Agent_1"] == "grasp barrier at left"
    assert set(answer["Constraints"]) == {"Logical", "Temporal", "Spatial"}
    assert answer["Constraints"]["Logical"][0]["Agent"] == "Agent_1"
    assert answer["Constraints"]["Temporal"][0]["Agents"] == ["Agent_1", "Agent_2"]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("not json", "not the expected JSON"),
        ("{}", "Subgoals"),
        ('{"Subgoals": {"Agent_1": "hold"}, "Extra": 1}', "Extra"),
        ('{"Subgoals": {"Agent_7": "hold"}}', "unknown agent 'Agent_7'; available: Agent_1, Agent_2"),
        ('{"Subgoals": {"Agent_1": "dance wildly"}}', "forms: grasp OBJECT at POINT"),
        ('{"Subgoals": {"Agent_1": "grasp barrier"}}', "lacks point"),
        (
            '{"Subgoals": {"Agent_1": "grasp lamp at left"}}',
            "no object 'lamp' in lift_barrier; available: barrier",
        ),
        (
            '{"Subgoals": {"Agent_1": "grasp barrier at top"}}',
            "no interaction point 'top'; available: left, right",
        ),
        ('{"Subgoals": {"Agent_1": "lift barrier"}}', "lacks height_m"),
    ],
)
def test_bad_answers_say_what_is_wrong(answer, message, lift_barrier):
    with pytest.raises(BadAnswer, match=message.replace("(", r"\(")):
        from_json(answer, lift_barrier)


@given(text=st.text(max_size=300))
def test_any_text_is_an_answer_or_a_clear_error(text):
    task = read_task("lift_barrier")
    for attempt in (lambda: from_json(text, task), lambda: parse_subgoal(1, text, task)):
        try:
            attempt()
        except BadAnswer as error:
            assert str(error)


def test_empty_proposal_means_nothing_left_to_do(lift_barrier):
    assert from_json(to_json(Proposal((), ())), lift_barrier).subgoals == ()


def test_unknown_brain_names_what_exists():
    with pytest.raises(ArgumentError, match="unknown brain 'oracle'; available: scripted"):
        make_brain("oracle")
