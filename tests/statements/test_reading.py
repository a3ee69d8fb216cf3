"""Every way to state a constraint, what it means, and what happens to sentences that mean nothing."""

import re
from contextlib import suppress

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from rf_exp.constraints import compiled
from rf_exp.errors import ArgumentError
from rf_exp.statements import (
    MAX_LENGTH,
    AvoidAgents,
    AvoidObjects,
    Before,
    ContactAt,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    LiesOn,
    PlaceAt,
    Proposal,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
    Unread,
    Vocabulary,
    kinds,
    read,
    samples,
)
from rf_exp.types import Subgoal
from tests.conftest import CONF
from tests.constraints.robots import real, team

FOOD, BAR = real("place_food"), real("lift_barrier")
PROPOSAL = Proposal(
    (
        Subgoal(1, "grasp", "steak", "center"),
        Subgoal(1, "place", "steak", target="pot", target_point="inside"),
        Subgoal(2, "grasp", "lid", "knob"),
        Subgoal(2, "lift", "lid", height_m=0.1),
        Subgoal(2, "place", "lid", target="aside"),
    ),
    (),
)
BOTH = Proposal(tuple(Subgoal(agent, verb, "barrier") for agent in (1, 2) for verb in ("grasp", "lift")), ())


def checked(text: str, task=FOOD, proposal=PROPOSAL, agents=(1, 2)) -> str:
    """The check that a sentence means, as the paper prints it."""
    return repr(compiled(read(text, task.vocabulary, agents), task, proposal))


LOGICAL = [
    ("Agent_1 must grasp steak at its center point.", "VI(Agent_1, steak, center)"),
    ("agent 1 should pick up the steak by its centre", "VI(Agent_1, steak, center)"),
    ("Agent_2 must grasp the knob point of lid.", "VI(Agent_2, lid, knob)"),
    ("Agent_1 must place steak at the inside point of pot.", "VI(Agent_1, pot, inside)"),
    ("Agent_1 must put the steak into the inside of the pot", "VI(Agent_1, pot, inside)"),
    ("The gripper of Agent_1 must be perpendicular to steak.", "VD(Agent_1, steak, perpendicular)"),
    ("The gripper of Agent_1 is perpendicular to steak when grasping.", "VD(Agent_1, steak, perpendicular)"),
    ("The gripper of Agent_2 should be level at the lid", "VD(Agent_2, lid, level)"),
    ("The gripper of Agent_2 must be horizontal to lid", "VD(Agent_2, lid, horizontal)"),
    ("Agent_1 must approach steak from above.", "VD(Agent_1, steak, vertical)"),
    ("Agent_1 must approach steak perpendicularly.", "VD(Agent_1, steak, perpendicular)"),
    (
        "Agent_1 and Agent_2 must keep a consistent gripper height.",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
    (
        "Agent_1 and Agent_2 must maintain a consistent gripper height",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
    (
        "Keep the gripper height consistent between Agent_1 and Agent_2.",
        "VD([Agent_1, Agent_2], consistent height)",
    ),
]
TEMPORAL = [
    ("Agent_1 and Agent_2 perform tasks simultaneously.",
     "VS([Agent_1, Agent_2], simultaneous, within 0.1 s)"),
    ("Agent_1 and Agent_2 must perform their tasks at the same time within 2 seconds",
     "VS([Agent_1, Agent_2], simultaneous, within 2 s)"),
    ("Agent_2 must lift lid before Agent_1 may place steak.",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_2 must raise the lid before Agent_1 begins to put the steak",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_1 must place steak only after Agent_2 lifts lid.",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_1 places the steak after Agent_2 has opened the lid",
     "VS([Agent_2, Agent_1], sequential, lift lid, place steak)"),
    ("Agent_2 must complete its task before Agent_1 begins.", "VS([Agent_2, Agent_1], sequential)"),
    ("Agent_2 must complete the task before Agent_1 can begin their action.",
     "VS([Agent_2, Agent_1], sequential)"),
    ("Agent_2 must lift lid before Agent_1 starts.", "VS([Agent_2, Agent_1], sequential, lift lid)"),
    ("Agent_1 must wait 2 s after Agent_2 has finished.", "VS([Agent_2, Agent_1], sequential, wait 2 s)"),
    ("Agent_1 waits at least 0.5 seconds after Agent_2", "VS([Agent_2, Agent_1], sequential, wait 0.5 s)"),
    ("Agent_1 must wait 2 s after Agent_2 lifts lid.",
     "VS([Agent_2, Agent_1], sequential, lift lid, wait 2 s)"),
    ("Agent_1 must finish within 10 s.", "VS(Agent_1, deadline, 10 s)"),
    ("Agent_2 must lift lid within 10 s.", "VS(Agent_2, deadline, lift lid, 10 s)"),
    ("Agent_1 and Agent_2 may share the same space one after the other.",
     "VS([Agent_1, Agent_2], share space)"),
    ("Agent_2 and Agent_1 could share the same space chronologically.",
     "VS([Agent_2, Agent_1], share space)"),
]  # fmt: skip
SPATIAL = [
    ("Avoid collision between Agent_1 and other agents.", "VSO(Agent_1)"),
    ("AVOID COLLISIONS BETWEEN AGENT_2 AND OTHER AGENTS", "VSO(Agent_2)"),
    ("Agent_2 must not intersect with the trajectories of other agents.", "VSO(Agent_2)"),
    ("Avoid collision between Agent_1 and Agent_2.", "VSO([Agent_1, Agent_2])"),
    ("Agent_1 should not occupy the same space as Agent_2.", "VSO([Agent_1, Agent_2])"),
    ("Agents must avoid colliding with each other.", "VSO([Agent_1, Agent_2])"),
    ("Agent_1 must avoid Agent_2.", "VSO([Agent_1, Agent_2])"),
    (
        "Agent_1 may not enter the region (0, 0, 0) to (1, 1, 1)",
        "VSO(Agent_1, zone (0.0, 0.0, 0.0) to (1.0, 1.0, 1.0))",
    ),
    ("Agent_1 and Agent_2 must not collide.", "VSO([Agent_1, Agent_2])"),
    ("Avoid collision between Agent_1 and the objects.", "VSO(Agent_1, objects)"),
    ("Agent_1 must not touch any other objects", "VSO(Agent_1, objects)"),
    ("Avoid collision between Agent_2 and the environment.", "VSO(Agent_2, objects)"),
    (
        "Agent_1 must stay out of zone (-0.1, 0.2, 0) to (0.1, 0.4, 0.5).",
        "VSO(Agent_1, zone (-0.1, 0.2, 0.0) to (0.1, 0.4, 0.5))",
    ),
]


@pytest.mark.parametrize(("text", "code"), [*LOGICAL, *TEMPORAL, *SPATIAL])
def test_a_sentence_becomes_its_check(text, code):
    assert checked(text) == code


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
def test_a_sentence_about_two_arms_and_one_thing(text, code):
    assert checked(text, BAR, BOTH) == code


LIFT, PLACE, BOX = Step(2, "lift", "lid"), Step(1, "place", "steak"), ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
ZONE = "zone (0, 0, 0) to (1, 1, 1)"
ENGLISH: dict[str, Statement] = {
    # who is meant
    "Agent 1 and 2 must keep the same gripper height": SameHeight((1, 2)),
    "Agents 1 and 2 keep a consistent height": SameHeight((1, 2)),
    "Robots 1 and 2 must maintain identical gripper heights": SameHeight((1, 2)),
    "Robot 1 must not collide with robot 2": AvoidAgents((1, 2)),
    "The left arm must not touch the right arm.": AvoidAgents((1, 2)),
    "The right robot must finish within 3 s": Deadline(Step(2), 3.0),
    "Agents must avoid colliding with each other": AvoidAgents((1, 2)),
    # what waits for what
    "Agent_1 must not place the steak before Agent 2 has lifted the lid": Before(LIFT, PLACE),
    "Agent 1 mustn't place the steak until Agent 2 has lifted the lid": Before(LIFT, PLACE),
    "Agent_1 must wait until Agent_2 has lifted the lid": Before(LIFT, Step(1)),
    "Agent_1 waits for Agent_2 to lift the lid": Before(LIFT, Step(1)),
    "Agent_1 waits for Agent_2 to finish": Before(Step(2), Step(1)),
    "Agent_1 waits until Agent_2 has lifted the lid before placing the steak": Before(LIFT, PLACE),
    "Agent_1 waits until Agent 2 has let go of the lid": Before(Step(2, "release", "lid"), Step(1)),
    "First Agent 2 lifts the lid, then Agent 1 places the steak.": Before(LIFT, PLACE),
    "Agent 2 lifts the lid and then Agent 1 puts the steak": Before(LIFT, PLACE),
    "After Agent 2 has lifted the lid, Agent 1 must place the steak": Before(LIFT, PLACE),
    "Before Agent 1 places the steak, Agent 2 must lift the lid": Before(LIFT, PLACE),
    "Agent 1 must place the steak once the lid has been lifted by Agent 2": Before(LIFT, PLACE),
    "The lid must be lifted by Agent 2 before Agent 1 starts placing the steak": Before(LIFT, PLACE),
    "Agent_2 must lift the lid before Agent_1 begins to lift the steak": Before(
        LIFT, Step(1, "lift", "steak")
    ),
    "Agent_1 must wait until the lid is on the table": Before(LiesOn("lid"), Step(1)),
    "Agent_1 must place the steak only after the lid lies on the table": Before(LiesOn("lid"), PLACE),
    "Agent_2 must wait until the steak is on the pot": Before(LiesOn("steak", "pot"), Step(2)),
    "Agent_1 must place the steak at least 2 s after Agent_2 lifts the lid": Before(LIFT, PLACE, 2.0),
    # limits
    "Agents 1 and 2 must keep their grippers at least 10 cm apart": KeepApart((1, 2), 0.1),
    "The grippers of Agent_1 and Agent_2 must stay at least 70 mm apart": KeepApart((1, 2), 0.07),
    "Agent_1 must stay at least 5 cm away from Agent_2": KeepApart((1, 2), 0.05, "arms"),
    "Keep the pot upright": KeepLevel("pot"),
    "Agent_2 must keep the lid level within 5 degrees": KeepLevel("lid", 5.0, 2),
    "The lid must be kept upright": KeepLevel("lid"),
    "Agent_1 must keep its gripper below 40 cm over the table": KeepHeight(1, 0.4),
    "The hand of Agent_2 must stay above 2 cm": KeepHeight(2, 0.02, "above"),
    "Agent_1 must not move faster than 20 cm/s": SpeedLimit(1, 0.2),
    "Agent_2 must move its gripper no faster than 0.3 m/s": SpeedLimit(2, 0.3),
    # when it holds
    f"Agent_1 must stay out of {ZONE} while Agent_2 is there": KeepOut(1, *BOX, occupied_by=2),
    f"Agent_1 must not enter the {ZONE} as long as the lid is still in it": KeepOut(
        1, *BOX, occupied_by="lid"
    ),
    f"Agent_1 must stay out of {ZONE} until the lid is on the table": KeepOut(1, *BOX, until=LiesOn("lid")),
    f"Agent_1 must avoid {ZONE} until Agent_2 is done": KeepOut(1, *BOX, until=Step(2)),
    "Agents 1 and 2 must keep the same height when lifting the lid": SameHeight((1, 2), "lift", "lid"),
    "Agent_2 must keep its gripper level while lifting the lid": Direction(2, "lid", "level", "lift"),
    "The gripper of Agent_2 must stay vertical when carrying the lid": Direction(
        2, "lid", "vertical", "carry"
    ),
}


@pytest.mark.parametrize("text", ENGLISH)
def test_ordinary_english_is_understood(text):
    assert read(text, FOOD.vocabulary) == ENGLISH[text]


def test_sides_are_those_of_the_global_camera():
    """Who stands left in the picture that a model is sent is the left arm."""
    assert FOOD.vocabulary.sides == {"left": 1, "right": 2}
    assert real("take_photo").vocabulary.sides == {}  # of four nobody is just left or right
    with pytest.raises(ArgumentError, match="is not understood"):
        read("The left arm must finish within 3 s", real("take_photo").vocabulary)


AGENT, OBJECT = st.sampled_from((1, 2)), st.sampled_from(("lid", "pot", "steak"))
VERB = st.sampled_from(("grasp", "lift", "carry", "place", "strike", "press", "release", "hold"))
STEP = st.builds(Step, AGENT) | st.builds(Step, AGENT, VERB, OBJECT)
SECONDS = st.floats(0, 600, allow_subnormal=False)
CORNERS = st.tuples(*[st.floats(-9, 9, allow_subnormal=False)] * 3).map(
    lambda low: (tuple(value + 0.0 for value in low), tuple(value + 0.5 for value in low))
)
LENGTH = st.floats(0, 2, allow_subnormal=False)
PAIR = st.sampled_from(((1, 2), (2, 1)))


def other_than(step: Step) -> st.SearchStrategy[Step]:
    return STEP.filter(lambda then: then.agent != step.agent)


BEFORE = STEP.flatmap(
    lambda first: st.builds(Before, st.just(first) | st.builds(LiesOn, OBJECT), other_than(first), SECONDS)
)
STATED: dict[type[Statement], st.SearchStrategy[Statement]] = {
    ContactAt: st.sampled_from((("lid", "knob"), ("steak", "center"))).flatmap(
        lambda at: st.builds(ContactAt, AGENT, st.just("grasp"), st.just(at[0]), st.just(at[1]))
    ),
    PlaceAt: st.builds(PlaceAt, AGENT, OBJECT, st.just("pot"), st.just("inside")),
    Direction: st.builds(
        Direction, AGENT, OBJECT, st.sampled_from(("vertical", "horizontal", "level")), st.none() | VERB
    )
    | st.builds(
        Direction, AGENT, OBJECT, st.just("perpendicular"), st.sampled_from((None, "grasp", "press"))
    ),
    SameHeight: st.builds(SameHeight, PAIR) | st.builds(SameHeight, PAIR, VERB, OBJECT),
    Before: BEFORE,
    Together: st.builds(Together, PAIR, VERB, OBJECT, SECONDS) | st.builds(Together, PAIR, within_s=SECONDS),
    Deadline: st.builds(Deadline, STEP, SECONDS),
    ShareSpace: st.builds(ShareSpace, PAIR),
    KeepApart: st.builds(KeepApart, st.just((1, 2)), LENGTH, st.sampled_from(("grippers", "arms"))),
    KeepLevel: st.builds(KeepLevel, OBJECT, st.floats(0, 90, allow_subnormal=False), st.none() | AGENT),
    KeepHeight: st.builds(KeepHeight, AGENT, LENGTH, st.sampled_from(("below", "above"))),
    SpeedLimit: st.builds(SpeedLimit, AGENT, st.floats(0.01, 10)),
    AvoidAgents: st.sampled_from((AvoidAgents((1,)), AvoidAgents((2,)), AvoidAgents((1, 2)))),
    AvoidObjects: st.builds(AvoidObjects, AGENT),
    KeepOut: CORNERS.flatmap(
        lambda box: (
            st.builds(KeepOut, st.just(1), st.just(box[0]), st.just(box[1]))
            | st.builds(KeepOut, st.just(1), st.just(box[0]), st.just(box[1]), st.just(2) | OBJECT)
            | st.builds(
                KeepOut,
                st.just(1),
                st.just(box[0]),
                st.just(box[1]),
                until=STEP.filter(lambda step: step.agent == 2) | st.builds(LiesOn, OBJECT),
            )
        )
    ),
}


def test_the_law_is_about_every_kind():
    assert set(STATED) == set(kinds()) - {Unread}


@pytest.mark.parametrize("kind", STATED, ids=lambda kind: kind.__name__)
def test_the_sentence_of_a_statement_says_the_statement(kind):
    """The law of the language, over all kinds."""

    @settings(max_examples=150, deadline=500)
    @given(STATED[kind])
    def law(stated: Statement) -> None:
        assert read(stated.sentence, FOOD.vocabulary) == stated

    law()


def test_the_documentation_shows_every_sample():
    text = (CONF.parent / "docs/constraints.md").read_text("utf-8")
    assert [each.sentence for each in samples() if f"| {each.kind} | {each.sentence} |" not in text] == []


def test_samples_show_every_kind_in_its_own_words():
    words = team(3).vocabulary
    points = {"barrier": {"left": "grasp"}, "lid": {}, "steak": {}, "pot": {"inside": "drop"}}
    vocabulary = Vocabulary(words.agents, points)
    shown = list(samples())
    assert {type(sample) for sample in shown} == set(STATED)
    assert [read(sample.sentence, vocabulary) for sample in shown] == shown


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


def test_agents_without_names_are_all_of_them_whatever_the_sentence_is_filed_under():
    for text in ("Agents must avoid colliding with each other.", "All agents must not collide."):
        assert checked(text, team(3), Proposal((), ()), (1, 3)) == "VSO([Agent_1, Agent_2, Agent_3])"


def test_a_sentence_that_names_nobody_is_about_those_it_is_filed_under():
    text = "Keep the gripper height consistent."
    for filed, agents in (((1, 3), (1, 3)), ((), (1, 2, 3))):
        assert read(text, team(3).vocabulary, filed) == SameHeight(agents)


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
def test_a_sentence_that_cannot_be_used_says_why(text, message):
    with pytest.raises(ArgumentError, match=message):
        checked(text)


# Sentence -> the words in the way; none where words of the grammar are in an order of no form. Had they been
# dropped, each sentence would have meant a check that it does not say.
DROPPED = {
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


@pytest.mark.parametrize("text", DROPPED)
def test_a_sentence_is_understood_whole_or_refused_with_the_words_in_the_way(text):
    why = f"cannot read {DROPPED[text]!r}" if DROPPED[text] else "knows these words, but not in this order"
    expected = f"constraint {text!r} is not understood: the grammar {why}; the nearest that is: '"
    with pytest.raises(ArgumentError, match=re.escape(expected)):
        checked(text)


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
        checked(text)


FILLERS = (
    "the a an its both any all other up down of for to it only has have must should shall will may can could "
    "begins starts point side end part handle interaction contact grasp done stops stopped ends ended "
    "finishes finished completes completed"
)
CONTENT = (
    "while until unless except without not never maybe possibly almost slowly gently twice again if possible "
    "otherwise instead unlike zero behind lid steak pot Agent_1 Agent_2 100 -1 ; { } ( ) s m within before "
    "after table zone grasping lift place drop wait together simultaneously vertical level and or then"
)
UNDERSTOOD = [text.rstrip(".").split() for text, _ in [*LOGICAL, *TEMPORAL, *SPATIAL]]


@settings(max_examples=600, deadline=500)
@given(
    words=st.sampled_from(UNDERSTOOD),
    at=st.integers(0, 30),
    inserted=st.sampled_from(CONTENT.split())
    | st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=9),
)
def test_a_word_more_is_refused_and_never_another_meaning(words, at, inserted):
    """A content word anywhere in a sentence that is understood: nothing reads it, so nothing drops it."""
    assume(inserted.lower() not in FILLERS.split() and not set(inserted) <= set(".! "))
    at = min(at, len(words))
    with pytest.raises(ArgumentError, match="constraint"):
        checked(" ".join([*words[:at], inserted, *words[at:]]))


def test_fillers_change_no_meaning():
    for words, (_, code) in zip(UNDERSTOOD, [*LOGICAL, *TEMPORAL, *SPATIAL], strict=True):
        for at in range(len(words) + 1):
            for filler in ("the", "its", "both", "any", "all", "only", "up", "may", "can", "must"):
                text = " ".join([*words[:at], filler, *words[at:]])
                with suppress(ArgumentError):
                    assert checked(text) == code, text


WORDS = (
    "Agent_1 Agent_2 Agent_99 agent must grasp lift before after and , the of steak lid zone ( ) to "
    "simultaneously within 1e999 -0 nan inf s other agents not avoid collision between ; __import__('os') "
    "{0} %s \\ \x00 \n"
)
HOSTILE = st.one_of(
    st.text(max_size=400), st.lists(st.sampled_from(WORDS.split(" ")), max_size=25).map(" ".join)
)


@settings(max_examples=400, deadline=500)
@given(HOSTILE)
@example("__import__('os').system('touch /tmp/owned')")
@example("Agent_1 must finish within 1e999 s.")
@example("Agent_" + "9" * 200 + " must finish within 1 s.")
@example("Agent_1" + " and Agent_1" * 23 + " must")
@example("the " * 70)
def test_hostile_text_is_refused_or_understood_but_never_run(text):
    try:
        stated = read(text, FOOD.vocabulary, (1, 2))
    except ArgumentError as error:
        assert str(error)
    else:
        assert read(stated.sentence, FOOD.vocabulary) == stated


def test_a_contact_that_no_subgoal_makes_is_refused_with_the_points_there_are():
    grasp = Proposal((Subgoal(2, "grasp", "barrier", "right"),), ())
    with pytest.raises(
        ArgumentError, match=r"demands point left, but Agent_2 is to meet barrier at right; change"
    ):
        checked("Agent_2 must grasp barrier at its left point.", BAR, grasp)


def test_a_gripper_does_not_meet_a_point_to_work_with():
    hammer = Proposal((Subgoal(1, "grasp", "hammer", "handle"),), ())
    with pytest.raises(ArgumentError, match=r"head of hammer is for the work of the tool, not for a gripper"):
        checked("Agent_1 must grasp hammer at its head point.", real("strike_cube"), hammer, agents=(1,))
