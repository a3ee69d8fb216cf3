"""Sentences without a meaning here, or with another one, are refused with the words that cannot be read."""

import re

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import MAX_LENGTH, Proposal
from rf_exp.types import Subgoal
from tests.constraints.robots import real
from tests.statements.sentences import BAR, check_code

ERRORS = [
    ("Be nice to each other.",
     r"constraint 'Be nice to each other.' is not understood: the grammar cannot read 'nice'; "
     r"the nearest that is: '[^']+'; agents: Agent_1, Agent_2; "
     r"objects with their points: pot \(inside\), lid \(knob\), steak \(center\)$"),
    ("Please, Agent_1 must kindly grasp steak very gently and slowly at its center point.",
     r"the grammar cannot read 'Please, kindly very gently slowly'; "
     r"the nearest that is: 'Agent_1 must grasp barrier at its left point.'"),
    ("must Agent_1 steak grasp", r"the grammar knows these words, but not in this order; the nearest"),
    ("", r"constraint '' is not understood: the grammar finds no words; the nearest that is: 'Agent_1"),
    ("Agent_7 must grasp steak at its center point.",
     r"unknown agent in constraint 'Agent_7 .*': 'Agent_7'; available: Agent_1, Agent_2"),
    ("Agent_1 must grasp hat at its center point.",
     r"unknown object in constraint '.*': 'hat'; available: lid, pot, steak"),
    ("Agent_1 must grasp steak at its nose point.",
     r"unknown point of steak in constraint '.*': 'nose'; available: center"),
    ("Agent_2 must juggle lid before Agent_1 may place steak.",
     r"is not understood: the grammar cannot read 'juggle'; the nearest that is: 'Agent_2 must lift lid"),
    ("Agent_2 must press lid before Agent_1 may place steak.",
     r"speaks of Agent_2: press lid, which is no subgoal of Agent_2; its subgoals: grasp lid at knob;"),
    ("Agent_1 must finish before Agent_1 begins.", r"needs two different agents; it names Agent_1"),
    ("Avoid collision between Agent_2 and Agent_2.", r"needs two different agents; it names Agent_2"),
    ("Agent_1 and Agent_1 must keep a consistent gripper height.",
     r"needs two different agents; it names Agent_1"),
    ("Agent_1 must finish within 1e9 s.", r"1e\+09 s is not between 0 and 600 s"),
    ("Agent_1 must finish within -1 s.", r"-1 s is not between 0 and 600 s"),
    ("Agent_1 must stay out of zone (0, 0, 0) to (1e99, 1, 1).", r"zones lie within 10 m of the origin"),
    ("Agent_1 must keep its gripper below 3 m.", r"3 m is not between 0 and 2 m"),
    ("Agent_1 must not move faster than 1 mm/s.", r"0.001 m/s is not between 0.01 and 10 m/s"),
    ("Agent_1 must keep the lid level within 100 deg.", r"100 deg is not between 0 and 90 deg"),
    ("Agents 1 and 1 must keep their arms at least 5 cm apart.", r"needs two different agents; it names Ag"),
    ("Agent_1 must stay out of zone (0, 0, 0) to (1, 1, 0).",
     r"the zone is flat; each side must be at least 1 mm"),
    ("Avoid " * 80, rf"constraint of 480 characters; a constraint is one sentence of up to {MAX_LENGTH}"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), ERRORS)
def test_an_unusable_sentence_is_explained(text, message):
    with pytest.raises(ArgumentError, match=message):
        check_code(text)


# Sentence -> the words that cannot be read; empty where known words are in an order of no form. If they were
# ignored, each sentence would become a check with another meaning.
UNREAD_WORDS = {
    "Agent_1 must avoid zone (0, 0, 0) to (1, 1, 1) while Agent_2 is thirsty.": "while Agent_2 is thirsty",
    "Agent_1 must grasp steak at its center point without closing its hand.": "without closing its hand",
    "Agent_1 must grasp steak very slowly at its center point.": "very slowly",
    "Agent_2 must lift lid before Agent_1 may place steak in order that it never happens.": (
        "in order that it never happens"
    ),
    "Agent_2 must lift lid before Agent_1 begins unless Agent_1 holds steak.": "unless Agent_1 holds steak",
    "Agent_1 must finish within 10 s if possible.": "if possible",
    "Agent_1 may finish within 10 s.": "may",
    "Agent_1 can be done within 10 s": "",
    "Agent_2 must try to lift lid within 10 s.": "try to",
    "Agent_2 must be able to lift lid within 10 s.": "be able to",
    "Agent_2 must not lift lid within 10 s.": "not",
    "Agent_2 must never lift lid before Agent_1 begins.": "never",
    "Agent_1 may place steak after Agent_2 lifts lid.": "may",
    "Agent_1 should not occupy the same space as Agent_2 in the designated area.": "in the designated area",
    "Agents must avoid colliding with each other when moving close by.": "when moving close by",
    "Agent_1 and Agent_2 perform tasks simultaneously without interference.": "without interference",
    "Keep the gripper height consistent between Agent_1 and Agent_2 to keep the pot level.": (
        "to keep the pot level"
    ),
    "Keep the gripper height of Agent_1 and Agent_2 consistent between Agent_2 and Agent_1.": (
        "of Agent_1 and Agent_2"
    ),
    "Avoid collision between Agent_1 and other agents except Agent_2.": "except Agent_2",
    "Avoid collision between Agent_1 and other agents at any speed above 1 m/s.": (
        "at any speed above 1 m/s"
    ),
    "Must avoid Agent_1 and Agent_2.": "",
    "Agent_1 and Agent_2 must share the same space one after the other.": "",
    "Agent_1 must not touch the table.": "",
    "The gripper of Agent_1 must be level with steak.": "",
    "The gripper of Agent_1 must stay vertical over steak.": "",
    "The gripper of Agent_1 must be aligned with steak.": "aligned",
    "Agent_1 must approach steak downstream.": "downstream",
    "Agent_1 must wait 2 s after Agent_2 has finished endlessly.": "endlessly",
}


@pytest.mark.parametrize("text", UNREAD_WORDS)
def test_a_sentence_is_understood_completely_or_refused_with_the_unread_words(text):
    reason = (
        f"cannot read {UNREAD_WORDS[text]!r}"
        if UNREAD_WORDS[text]
        else "knows these words, but not in this order"
    )
    expected = f"constraint {text!r} is not understood: the grammar {reason}; the nearest that is: '"
    with pytest.raises(ArgumentError, match=re.escape(expected)):
        check_code(text)


OTHER_MEANINGS = [
    ("Agent_1 must place lid at the inside point of pot.",
     "speaks of Agent_1: place lid to pot, which is no subgoal of Agent_1; its subgoals: grasp steak at"),
    ("Agent_1 must release steak at its center point.", "center point of steak is to grasp, not to release"),
    ("Agent_1 must lift the center point of steak.", "the center point of steak is to grasp, not to lift"),
    ("Agent_1 must lift steak at the inside point of pot.", "to lift steak is not to place it"),
    ("Agent_1 must press steak perpendicularly.", "speaks of Agent_1: press steak, which is no subgoal"),
    ("The gripper of Agent_1 is perpendicular to steak when pressing.", "speaks of Agent_1: press steak"),
    ("Agent_1 must grasp steak quickly at its center point.", "unknown object in .*'steak_quickly'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), OTHER_MEANINGS)
def test_a_sentence_whose_words_mean_something_else_is_refused(text, message):
    with pytest.raises(ArgumentError, match=message):
        check_code(text)


def test_a_contact_of_no_subgoal_is_refused_with_the_available_points():
    grasp = Proposal((Subgoal(2, "grasp", "barrier", "right"),), ())
    with pytest.raises(
        ArgumentError, match=r"demands point left, but Agent_2 is to meet barrier at right; change"
    ):
        check_code("Agent_2 must grasp barrier at its left point.", BAR, grasp)


def test_a_gripper_cannot_meet_a_tool_point():
    hammer = Proposal((Subgoal(1, "grasp", "hammer", "handle"),), ())
    with pytest.raises(ArgumentError, match=r"head of hammer is for the work of the tool, not for a gripper"):
        check_code("Agent_1 must grasp hammer at its head point.", real("strike_cube"), hammer, agents=(1,))
