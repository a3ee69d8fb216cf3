"""All formulations of constraints and their meanings."""

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import Before, Deadline, KeepOut, Proposal, SameHeight, Step, Together, read
from rf_exp.types import Subgoal
from tests.constraints.robots import real, team
from tests.statements.sentences import BAR, ENGLISH, FOOD, LOGICAL, SPATIAL, TEMPORAL, check_code

BOTH = Proposal(tuple(Subgoal(agent, verb, "barrier") for agent in (1, 2) for verb in ("grasp", "lift")), ())


@pytest.mark.parametrize(("text", "code"), [*LOGICAL, *TEMPORAL, *SPATIAL])
def test_a_sentence_becomes_its_check(text, code):
    assert check_code(text) == code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (
            "Agent_1 and Agent_2 must lift barrier simultaneously within 0.5 s.",
            "VS([Agent_1, Agent_2], simultaneous, lift barrier, within 0.5 s)",
        ),
        (
            "Agent 1 and agent 2 grasp the barrier together",
            "VS([Agent_1, Agent_2], simultaneous, grasp barrier, within 0.1 s)",
        ),
        ("Agent_1 must grasp the left end of barrier.", "VI(Agent_1, barrier, left)"),
    ],
)
def test_a_sentence_about_two_arms_and_one_object(text, code):
    assert check_code(text, BAR, BOTH) == code


@pytest.mark.parametrize("text", ENGLISH)
def test_ordinary_english_is_understood(text):
    assert read(text, FOOD.vocabulary) == ENGLISH[text]


def test_sides_are_those_of_the_global_camera():
    """The left arm is the one on the left of the picture that is sent to a model."""
    assert FOOD.vocabulary.sides == {"left": 1, "right": 2}
    assert real("take_photo").vocabulary.sides == {}  # ambiguous for four arms
    with pytest.raises(ArgumentError, match="is not understood"):
        read("The left arm must finish within 3 s", real("take_photo").vocabulary)


def test_parameters_arrive_as_values():
    for text, stated in {
        "Agent_1 and Agent_2 must lift barrier simultaneously within 0.25 s.": Together(
            (1, 2), "lift", "barrier", 0.25
        ),
        "Agent_1 must avoid zone (.1, 1e-1, 0) to (-.1, 0.5, +1)": KeepOut(
            1, (-0.1, 0.1, 0.0), (0.1, 0.5, 1.0)
        ),
        "Agent_1 must finish within 3 s": Deadline(Step(1), 3.0),
        "Agent_1 must finish before Agent_2 begins": Before(Step(1), Step(2)),
        "Agent_2 must finish before Agent_1 begins": Before(Step(2), Step(1)),
    }.items():
        assert read(text, BAR.vocabulary) == stated


def test_unnamed_agents_are_all_agents_wherever_the_sentence_is_listed():
    for text in ("Agents must avoid colliding with each other.", "All agents must not collide."):
        assert check_code(text, team(3), Proposal((), ()), (1, 3)) == "VSO([Agent_1, Agent_2, Agent_3])"


def test_a_sentence_without_agents_applies_to_those_it_is_listed_under():
    text = "Keep the gripper height consistent."
    for listed_under, agents in (((1, 3), (1, 3)), ((), (1, 2, 3))):
        assert read(text, team(3).vocabulary, listed_under) == SameHeight(agents)
