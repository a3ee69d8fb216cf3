"""Comparison of brains: legal answers, the random baseline, and the record of answers."""

import json
from collections.abc import Iterator

import pytest

from rf_exp.constraints import RoboChecker
from rf_exp.datagen import EpisodeGenerator, Settings
from rf_exp.datagen.brain import BadAnswer, FaultySpec, Question, RandomSpec, from_json, legal_answers
from rf_exp.datagen.brain.protocol import strict_answer
from rf_exp.datagen.episode import missing_constraints
from rf_exp.findings import Dialogue, Finding, ParseError, Ruling
from rf_exp.sim import Simulator
from rf_exp.statements import AvoidAgents, KeepLevel, Proposal, read, read_or_unparsed, read_subgoal
from rf_exp.tasks import Task
from rf_exp.types import Subgoal
from tests.conftest import TASKS, read_task
from tests.datagen.guard import FULL
from tests.scenes import start_scene


@pytest.fixture(params=TASKS)
def task(request: pytest.FixtureRequest) -> Task:
    return read_task(request.param)


def test_legal_answers_are_parsed_to_their_values(task: Task) -> None:
    legal = legal_answers(task, start_scene(task, 0))
    for agent, subgoals in legal.subgoals.items():
        assert subgoals and all(read_subgoal(agent, each.text, task.vocabulary) == each for each in subgoals)
    for each in legal.constraints:
        assert read(each.sentence, task.vocabulary, each.agents) == each


def test_random_answers_are_valid_and_vary(task: Task) -> None:
    question = Question(task, start_scene(task, 0), {})
    for seed in range(4):
        brain = RandomSpec().make(task, FULL, seed)
        proposal = from_json(brain.answer(question), task)
        assert proposal.subgoals and {each.agent for each in proposal.subgoals} == {*task.agents}
        assert RandomSpec().make(task, FULL, seed).answer(question) != brain.answer(question)


def enumerations(schema: object) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from (each for each in schema.get("enum", []))
        schema = list(schema.values())
    for each in schema if isinstance(schema, list) else ():
        yield from enumerations(each)


def test_an_enumerated_schema_lists_all_legal_answers(lift_barrier: Task) -> None:
    legal = legal_answers(lift_barrier, start_scene(lift_barrier, 0))
    schema = strict_answer(lift_barrier, legal).model_json_schema()
    listed = {*enumerations(schema)}
    assert {each.sentence for each in legal.constraints} < listed
    assert {each.text for some in legal.subgoals.values() for each in some} < listed
    assert "Anybody" not in json.dumps(schema)
    answer = {"Agent_1": ["grasp barrier at left", "lift barrier by 0.1 m"], "Agent_2": []}
    proposal = from_json(json.dumps({"Subgoals": answer}), lift_barrier)
    assert [each.text for each in proposal.subgoals] == answer["Agent_1"]


def test_missing_constraints_are_compared_without_their_numbers() -> None:
    level, all_clear = KeepLevel("pot", 5.0, 1), AvoidAgents((1, 2))
    stated = [KeepLevel("pot", 9.0, 1), AvoidAgents((2, 1))]
    assert missing_constraints([level, all_clear], stated) == []
    assert missing_constraints([level, all_clear], stated[:1]) == [all_clear]
    assert missing_constraints([KeepLevel("pot", 5.0, 2)], stated) == [KeepLevel("pot", 5.0, 2)]


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("no", Finding.NO_JSON),
        ("I cannot do that.", Finding.DECLINED),
        ('{"Subgoals": {"Agent_1": 3}}', Finding.OTHER_FORM),
        ('{"Subgoals": {"Agent_9": "home"}}', Finding.UNKNOWN_AGENT),
        ('{"Subgoals": {"Agent_1": "grasp lamp at left"}}', Finding.UNKNOWN_OBJECT),
        ('{"Subgoals": {"Agent_1": "grasp barrier at top"}}', Finding.UNKNOWN_POINT),
        ('{"Subgoals": {"Agent_1": "dance"}}', Finding.UNREAD_SUBGOAL),
        (json.dumps({"Subgoals": {"Agent_1": "home; aside;" * 9}}), Finding.TOO_MANY_SUBGOALS),
    ],
)
def test_refused_answers_have_a_finding(text: str, finding: Finding, lift_barrier: Task) -> None:
    with pytest.raises(BadAnswer) as refused:
        from_json(text, lift_barrier)
    assert refused.value.finding is finding


@pytest.mark.parametrize(
    ("sentence", "finding"),
    [
        ("Agent_1 must feel good.", Finding.UNREAD_CONSTRAINT),
        ("Agent_9 must grasp barrier at its left point.", Finding.UNKNOWN_AGENT),
        ("Agent_1 must grasp lamp at its left point.", Finding.UNKNOWN_OBJECT),
        ("Agent_1 must grasp barrier at its top point.", Finding.UNKNOWN_POINT),
        ("Agent_1 must lift barrier before Agent_2 may lift barrier.", Finding.UNFITTING_CONSTRAINT),
    ],
)
def test_refused_constraints_have_a_finding(sentence: str, finding: Finding, lift_barrier: Task) -> None:
    proposal = Proposal(
        (Subgoal(1, "home"),), (read_or_unparsed(sentence, lift_barrier.vocabulary, "spatial"),)
    )
    with pytest.raises(ParseError) as refused:
        RoboChecker(lift_barrier, proposal, FULL)
    assert refused.value.finding is finding


@pytest.mark.slow
def test_repairs_are_distinguished_from_rounds(lift_barrier: Task) -> None:
    with Simulator(lift_barrier, render=False) as world:
        settings = Settings.configured(lift_barrier, FULL, FaultySpec("missing_constraint"))
        no_refusals = EpisodeGenerator(settings, world, settings.make_brain(0)).make(0).dialogue
        settings = Settings.configured(lift_barrier, FULL, FaultySpec("wrong_direction"))
        outcome = EpisodeGenerator(settings, world, settings.make_brain(0)).make(0)
    assert (
        next(no_refusals.first_answers).missing == 1
        and no_refusals.repairs == 0
        and no_refusals.valid_after == 0
    )
    dialogue = outcome.dialogue
    rulings = Ruling.REFUSED, Ruling.CARRIED_OUT, Ruling.CARRIED_OUT
    assert (
        tuple(each.ruling for each in dialogue.answers)
        == (*rulings, Ruling.NOTHING_LEFT)[: len(dialogue.answers)]
    )
    assert [each.round for each in dialogue.answers[:3]] == [1, 1, 2]
    assert (dialogue.repairs, dialogue.valid_after) == (1, 1) and dialogue.codes == {"off_direction": 1}
    assert all(each.makespan_s >= each.bound_s > 0 for each in dialogue.answers[1:3])
    assert len(dialogue.busy) == 2 and all(0 < steps <= outcome.steps for steps in dialogue.busy)


def test_without_an_answer_nothing_is_valid() -> None:
    assert Dialogue().valid_after is None and Dialogue().repairs == 0 and not Dialogue().codes
