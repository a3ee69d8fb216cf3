"""Answers in the paper's JSON, and the configuration of brains: parsing and all errors."""

import json
import pickle
import re
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf

from rf_exp.datagen.brain import (
    BadAnswer,
    FaultySpec,
    OpenAISpec,
    Question,
    RandomSpec,
    ReplaySpec,
    ScriptedBrain,
    ScriptedSpec,
    from_json,
    read_brain,
    to_json,
)
from rf_exp.datagen.brain.protocol import max_subgoals
from rf_exp.errors import ArgumentError
from rf_exp.secrets import refuse_keys
from rf_exp.statements import Deadline, Proposal, Step, read_subgoal
from rf_exp.types import ConstraintSet, Subgoal
from tests.conftest import CONF, read_task
from tests.scenes import start_scene


@pytest.mark.slow
def test_scripted_plan_survives_the_round_trip(task):
    scene = start_scene(task, 0)
    text = ScriptedBrain().answer(Question(task, scene, {}))
    proposal, plan = from_json(text, task), task.module.plan(scene, task)
    # The paper's JSON lists subgoals by agent and constraints by kind, and keeps the order within each.
    assert [proposal.subgoals_of(agent) for agent in task.agents] == [
        plan.subgoals_of(agent) for agent in task.agents
    ]
    for kind in ("logical", "temporal", "spatial"):
        assert [c for c in proposal.constraints if c.kind == kind] == [
            c for c in plan.constraints if c.kind == kind
        ]
    assert to_json(proposal) == text
    assert {subgoal.agent for subgoal in proposal.subgoals} <= set(task.agents)


def test_answer_has_the_papers_structure(lift_barrier):
    answer = json.loads(ScriptedBrain().answer(Question(lift_barrier, start_scene(lift_barrier, 0), {})))
    assert answer["Subgoals"]["Agent_1"] == "grasp barrier at left"
    assert set(answer["Constraints"]) == {"Logical", "Temporal", "Spatial"}
    assert answer["Constraints"]["Logical"][0]["Agent"] == "Agent_1"
    assert answer["Constraints"]["Temporal"][0]["Agents"] == ["Agent_1", "Agent_2"]


HOLD = '{"Subgoals": {"Agent_1": "hold"}}'
ENTRY = '{"Subgoals": {"Agent_1": "hold"}, "Constraints": {"Logical": [{"Agent": "Agent_1", %s}]}}'
BAD = [
    # text that is not the paper's JSON
    ("", "not the expected JSON: it is empty"),
    ("not json", "not the expected JSON: there is no JSON in it, only text that begins 'not json'"),
    ("I'm sorry, but I can't help with that.", "the model refuses: I'm sorry, but I can't help with that."),
    ("<think>The barrier is long.", "it is thinking only, which no JSON follows"),
    ("The barrier is long.</think>\n", "it is thinking only, which no JSON follows"),
    (HOLD[:-4], "not the expected JSON: it is cut off"),
    (f"```json\n{HOLD[:-1]}\n```", "not the expected JSON: it is cut off"),
    (f"<think>Well.</think>{HOLD[:20]}", "not the expected JSON: it is cut off"),
    ('{"Subgoals": {"Agent_1": hold}}', "not the expected JSON: Expecting value, line 1"),
    ('{"Subgoals": {"Agent_1": NaN}}', "NaN is no number"),
    ('{"Subgoals": {"Agent_1": "hold", "Agent_1": "home"}}', "the key 'Agent_1' is there twice"),
    ("{}", "its JSON lacks 'Subgoals'; it holds nothing"),
    ('{"Plan": {"Agent_1": "hold"}}', "its JSON lacks 'Subgoals'; it holds 'Plan'"),
    ('{"name": "answer", "arguments": "{}"}', "its JSON lacks 'Subgoals'; it holds 'name', 'arguments'"),
    (HOLD + HOLD.replace("hold", "home"), "the answer holds 2 different objects with 'Subgoals'; send one"),
    (HOLD + '{"Constraints": ', "beside a whole object, it is cut off"),
    ('{"a":' * 20_000, "it is nested too deeply"),
    (HOLD + " " * 200_000, "the answer has 200033 characters; an answer has up to 200000"),
    # unknown and repeated keys
    ('{"Subgoals": {"Agent_1": "hold"}, "Constraint": "none"}', "the key 'Constraint' is not understood"),
    ('{"Subgoals": {"Agent_1": "hold"}, "Spatial": []}', "the key 'Spatial' is not understood; known: Subg"),
    ('{"Subgoals": {"Agent_1": "hold"}, "Rules": ["x"]}', "the key 'Rules' is not understood"),
    ('{"Subgoals": {"Agent_1": "hold"}, "Constraints": {"Safety": []}}', "known: Logical, Temporal, Spatial"),
    (ENTRY % '"Constraint": "x", "Unless": "y"', "the key 'Unless' is not understood; known: Agents, Constr"),
    (ENTRY % '"Agents": ["Agent_2"], "Constraint": "x"', "Agents is there twice"),
    ('{"Subgoals": {"Agent_1": "hold"}, "subgoals": {"Agent_1": "home"}}', "Subgoals is there twice"),
    # names
    ('{"Subgoals": {"Agent_7": "hold"}}', "unknown agent 'Agent_7'; available: Agent_1, Agent_2"),
    ('{"Subgoals": {"Agent_1": "hold", "agent 1": "home"}}', "the subgoals of Agent_1 are there twice"),
    ('{"Subgoals": {"Agent_1": "dance wildly"}}', "forms: grasp OBJECT at POINT"),
    ('{"Subgoals": {"Agent_1": "grasp barrier"}}', "lacks point"),
    ('{"Subgoals": {"Agent_1": "grasp lamp at left"}}',
     "no object 'lamp' in subgoal 'grasp lamp at left' of Agent_1; available: bar"),
    ('{"Subgoals": {"Agent_1": "grasp barrier at top"}}', "no interaction point 'top'; available: left"),
    ('{"Subgoals": {"Agent_1": "lift barrier"}}', "lacks height_m"),
    # parts, verbs and numbers of subgoals
    ('{"Subgoals": {"Agent_1": "home barrier"}}', "has object, which home has no use for; forms: grasp"),
    ('{"Subgoals": {"Agent_1": "lift barrier to goal by 0.1 m"}}', "has target, which lift has no use for"),
    ('{"Subgoals": {"Agent_1": "press barrier at left"}}', "the point left is to grasp; points of barrier to "
     "press at: none"),
    ('{"Subgoals": {"Agent_1": "hold%s"}}' % (" " * 200), "cannot read subgoal 'hold' of Agent_1"),
    ('{"Subgoals": {"Agent_1": "home; home"}}', "Agent_1 has the subgoal 'home' twice in a row"),
    ('{"Subgoals": {"Agent_2": "%s"}}' % ("home; " * 400), "Agent_2 has 400 subgoals; in one answer for "
     "lift_barrier an agent has up to 6"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "message"), BAD)
def test_errors_of_bad_answers_name_the_problem(answer, message, lift_barrier):
    with pytest.raises(BadAnswer, match=re.escape(message)):
        from_json(answer, lift_barrier)


CALL = json.dumps({"name": "answer", "arguments": HOLD})
READ = {
    "bare": HOLD,
    "in prose": f"Sure {{as asked}}! Here is the plan: {HOLD} Good luck.",
    "in a fence": f"```json\n{HOLD}\n```",
    "in a fence in prose": f"The plan:\n\n```\n{HOLD}\n```\nAgent_1 holds.",
    "after thinking": f"<think>Perhaps {HOLD.replace('hold', 'home')}? No.</think>\n{HOLD}",
    "after thinking without its first tag": f"Perhaps home?</think>{HOLD}",
    "inside thinking": f"<think>So it is {HOLD}</think>",
    "before thinking": f"{HOLD}<think>Was that right?</think>",
    "twice the same": f"{HOLD}\nAgain: {HOLD}",
    "a tool call as text": f"<tool_call>{CALL}</tool_call>",
    "a tool call with an object": json.dumps({"name": "answer", "arguments": json.loads(HOLD)}),
    "in a list": f"[{HOLD}]",
    "in a wrapper": f'{{"answer": {HOLD}}}',
    "keys in another case": HOLD.replace("Subgoals", "sub_goals"),
    "a list of subgoals": HOLD.replace('"hold"', '["hold"]'),
    "an agent without subgoals": HOLD.replace('"hold"', '"hold", "Agent_2": null'),
    "a remark": HOLD.replace("}}", '}, "Reasoning": ["It", "stands."], "Task": "Lift Barrier"}'),
    "a reason of a constraint": ENTRY % '"Constraint": "Agent_1 must finish within 9 s.", "Reason": "soon"',
    "agents as one": (ENTRY % '"Constraint": "Agent_1 must finish within 9 s."').replace(
        '"Agent"', '"Agents"'
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("way", READ)
def test_the_answer_is_extracted_from_the_text_of_a_model(way, lift_barrier):
    proposal = from_json(READ[way], lift_barrier)
    assert proposal.subgoals == (Subgoal(1, "hold"),)
    expected = [Deadline(Step(1), 9.0)]
    assert list(proposal.constraints) == (expected if "Constraints" in READ[way] else [])


def test_the_number_of_subgoals_of_an_agent_is_limited(task):
    """Scripted plans have at most half of the limit; one subgoal beyond it is refused."""
    plan = task.module.plan(start_scene(task, 0), task)
    max_count = max_subgoals(task)
    assert max(len(plan.subgoals_of(agent)) for agent in task.agents) <= max_count / 2
    line = "; ".join(("home", "aside")[k % 2] for k in range(max_count))
    assert len(from_json(json.dumps({"Subgoals": {"Agent_1": line}}), task).subgoals) == max_count
    with pytest.raises(BadAnswer, match=f"Agent_1 has {max_count + 1} subgoals"):
        from_json(json.dumps({"Subgoals": {"Agent_1": f"{line}; hold"}}), task)


@pytest.mark.slow
@given(text=st.text(max_size=300))
def test_any_text_is_an_answer_or_a_clear_error(text):
    task = read_task("lift_barrier")
    for attempt in (lambda: from_json(text, task), lambda: read_subgoal(1, text, task.vocabulary)):
        try:
            attempt()
        except (BadAnswer, ArgumentError) as error:
            assert str(error)


def test_an_empty_proposal_means_that_the_task_is_done(lift_barrier):
    assert from_json(to_json(Proposal((), ())), lift_barrier).subgoals == ()


def test_verbs_and_their_parts(lift_barrier):
    hammer = read_task("strike_cube")
    strike = read_subgoal(1, "strike hammer at head to cube at top", hammer.vocabulary)
    assert (strike.verb, strike.point, strike.target, strike.target_point) == (
        "strike",
        "head",
        "cube",
        "top",
    )
    carry = read_subgoal(2, "carry barrier to aside by 0.1 m", lift_barrier.vocabulary)
    assert (carry.target, carry.height_m) == ("aside", 0.1)
    for subgoal, task in ((strike, hammer), (carry, lift_barrier)):
        assert read_subgoal(subgoal.agent, subgoal.text, task.vocabulary) == subgoal
    with pytest.raises(ArgumentError, match="lacks point"):
        read_subgoal(1, "strike hammer to cube", hammer.vocabulary)


# -- configuration of brains ---------------------------------------------------------------------------


def brain_config(*overrides: str) -> dict[str, Any]:
    """The configuration of the brain as in a run."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        brain: Any = OmegaConf.to_container(compose("config", list(overrides)).brain, resolve=True)
    return brain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    {
        "scripted": ScriptedSpec,
        "openai": OpenAISpec,
        "replay": ReplaySpec,
        "faulty": FaultySpec,
        "random": RandomSpec,
    }.items(),
)
def test_every_configuration_makes_a_brain_that_can_be_pickled(
    name, kind, lift_barrier, monkeypatch, tmp_path
):
    monkeypatch.setenv("OPENAI_API_KEY", "sk-some-key")
    (tmp_path / "exchanges" / "openai+gpt-4o" / "lift_barrier" / "full").mkdir(parents=True)
    spec = read_brain(brain_config(f"brain={name}", f"out={tmp_path}"))
    assert isinstance(spec, kind) and spec.name == name
    brain = pickle.loads(pickle.dumps(spec)).make(lift_barrier, ConstraintSet("full"), 3)
    assert brain.name == name
    assert json.loads(json.dumps(dict(spec.identity)))["name"] == name
    assert b"sk-some-key" not in pickle.dumps(spec)


@pytest.mark.slow
def test_the_identity_holds_the_options_that_affect_answers():
    chosen = read_brain(
        brain_config("brain=openai", "brain.model=a", "brain.temperature=1", "brain.timeout_s=9")
    )
    patient = read_brain(
        brain_config("brain=openai", "brain.model=a", "brain.temperature=1", "brain.retries=9")
    )
    other = read_brain(brain_config("brain=openai", "brain.model=b", "brain.temperature=1"))
    assert chosen.identity == patient.identity != other.identity
    slashed = read_brain(brain_config("brain=openai", "brain.model='maker/b:free'"))
    assert (other.label, slashed.label) == ("openai+b", "openai+maker-b-free")
    assert (
        read_brain(brain_config("brain=faulty", "brain.fault=wrong_agent")).identity["fault"] == "wrong_agent"
    )


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"name": "oracle"}, "unknown brain 'oracle'; available: faulty, openai, random, replay, scripted"),
        ({"name": "faulty", "fault": "bad_luck"}, "unknown fault 'bad_luck'"),
        ({"name": "faulty"}, "brain 'faulty': missing value for field \"fault\""),
        ({"name": "scripted", "model": "x"}, "brain 'scripted': .*model"),
        ({"name": "openai", "model": 3}, "brain 'openai': .*model"),
    ],
)
def test_errors_of_brain_configurations_name_the_problem(node, message):
    with pytest.raises(ArgumentError, match=message):
        read_brain(node)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("budget", 0, "brain.budget is 0; it must be at least 1"),
        ("timeout_s", 0, "brain.timeout_s is 0.0; it must be above 0"),
        ("deadline_s", float("inf"), "brain.deadline_s is inf"),
        ("base_url", "localhost:8000", "'localhost:8000'; an example: http://localhost:8000/v1"),
        ("base_url", "http://[", "cannot be read; an example"),
        ("structured", False, "use brain.structured=true or brain.enumerated=false"),
    ],
)
def test_unusable_options_are_refused(key, value, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        read_brain(brain_config("brain=openai") | {"enumerated": True, key: value})


SECRET = "sk-live-abcdefgh12345678"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("api_key", SECRET),
        ("api_key_env", SECRET),
        ("base_url", f"https://me:{SECRET}@example.org/v1"),
        ("base_url", f"https://example.org/v1?key={SECRET}"),
    ],
)
def test_a_key_in_the_configuration_is_refused_without_repeating_it(key, value):
    for attempt in (
        lambda: read_brain(brain_config("brain=openai") | {key: value}),
        lambda: refuse_keys(["stages=[generate]", f"+brain.{key}={value}"]),
        lambda: refuse_keys([f"++brain.{key}='{value}'"]),
    ):
        with pytest.raises(ArgumentError, match="environment variable") as refused:
            attempt()
        assert SECRET not in str(refused.value)


def test_ordinary_arguments_are_not_taken_for_keys():
    refuse_keys(
        ["-m", "task=all", "brain=openai", "brain.api_key_env=MY_KEY", "brain.base_url=http://localhost:8000/v1",
         "brain.base_url=null", "seed=3", "training.betas=[0.9,0.99]", "--cfg", "job"]
    )  # fmt: skip
