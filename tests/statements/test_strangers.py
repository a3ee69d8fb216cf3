"""Sentences of authors who do not know the language: read with their meaning, or refused with advice."""

import re

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import Before, Step, Vocabulary, read
from rf_exp.statements.language import reading
from tests.statements.second_reading import misread
from tests.statements.sentences import BAR, FOOD
from tests.statements.strangers import READ, REFUSED


def parsed(text: str):
    return read(text, (BAR if "barrier" in text else FOOD).vocabulary, (1, 2))


def test_accepted_sentences_are_read_with_their_meaning():
    assert {text: parsed(text).sentence for text in READ} == READ
    assert {text: misread(text, parsed(text)) for text in READ} == dict.fromkeys(READ, "")


@pytest.mark.slow
def test_sentences_with_another_meaning_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reading, "_not_understood", lambda text, *_: ArgumentError(text))
    found = {}
    for text in REFUSED:
        try:
            found[text] = parsed(text).sentence
        except ArgumentError:
            continue
    assert found == {}
    assert len(REFUSED) > 500


ORDER_ADVICE = (
    "an order is between what is over and what begins: say 'Agent_2 must complete its task before Agent_1 "
    "begins.'"
)
STOP_ADVICE = "no plan says when an agent stops: say when it 'has finished', or what it 'has finished' doing"
DIRECTION_ADVICE = (
    "of a thing say 'Agent_1 must keep lid level.', of a gripper 'The gripper of Agent_1 must be vertical at "
    "lid when lifting it.'"
)
ADVICE = {
    "First Agent_2 lifts the lid, then Agent_1 finishes": ORDER_ADVICE,
    "First Agent_2 lifts the lid, then Agent_1 must finish": ORDER_ADVICE,
    "Agent_2 must lift the lid before Agent_1 ends": ORDER_ADVICE,
    "Agent_2 must begin before Agent_1 begins": ORDER_ADVICE,
    "Agent_1 must wait until Agent_2 starts": ORDER_ADVICE,
    "Agent_1 must place the steak after Agent_2 begins lifting the lid": ORDER_ADVICE,
    "Agent_1 waits until Agent_2 stops": STOP_ADVICE,
    "Agent_2 must stop before Agent_1 begins": STOP_ADVICE,
    "Agent_1 must lift the lid vertically": DIRECTION_ADVICE,
    "Agent_1 carries the lid horizontally": DIRECTION_ADVICE,
    "Agent_1 must keep the steak vertically": DIRECTION_ADVICE,
    "Agent_1 must keep the steak vertical": DIRECTION_ADVICE,
    "Agent_1 must place the steak from above": DIRECTION_ADVICE,
    "Agent_2 must remove the lid before Agent_1 begins": (
        "is not clear: to remove lid is to take it off and away; say 'lift', 'carry' or 'place'"
    ),
    "Agent_2 must pick up the lid before Agent_1 begins": (
        "is not clear: to pick up lid is to grasp and to lift it; say 'grasp' or 'lift'"
    ),
    "Agent_1 takes the steak after Agent_2 lifts the lid": (
        "is not clear: to take steak may be to grasp it or to carry it off; say 'grasp' or 'carry'"
    ),
    "Agent_2 must open the pot before Agent_1 begins": (
        "is not clear: of a lid, to open is to lift it; say what is lifted in place of pot"
    ),
    "Agent_1 must push the lid within 5 s": (
        "is not clear: to push lid may be to press on it or to shift it; say 'press' for the former"
    ),
    "Agent_1 and Agent_2 must lift the barrier together within 10 s": (
        "is not clear: is 10 s when they have to be done, or how far apart they begin? Say 'Agent_1 must "
        "lift barrier within 10 s.' of each of them, or 'within 10 s of each other'"
    ),
    "Agent_1 and Agent_2 must perform their tasks at the same time within 1 minute": (
        "Say 'Agent_1 must finish within 60 s.' of each of them, or 'within 10 s of each other'"
    ),
    "Agent_1 and Agent_2 must lift the barrier together within 600 s of each other": (
        "is not possible: 600 s is not between 0 and 10 s"
    ),
    "Agent_1 and Agent_2 must put the barrier together": (
        "is not clear: to put barrier together may be to join it; say 'simultaneously'"
    ),
    "Agent_1 must wait until the lid is on the lid": "is not possible: lid does not lie on itself",
}


@pytest.mark.parametrize("text", ADVICE)
def test_a_refusal_advises_possible_sentences(text: str):
    with pytest.raises(ArgumentError, match=re.escape(ADVICE[text])):
        parsed(text)


def test_sentences_in_an_advice_are_understood():
    for sentence in re.findall(
        r"'((?:Agent_|The gripper)[^']*\.)'", " ".join((ORDER_ADVICE, DIRECTION_ADVICE))
    ):
        assert read(sentence, FOOD.vocabulary)
    with pytest.raises(ArgumentError, match="is not clear") as refused:
        parsed("Agent_1 and Agent_2 must lift the barrier together within 10 s")
    separate, apart = re.findall(r"'([^']*)'(?: of each of them|$)", str(refused.value))
    assert parsed(separate).sentence == separate
    assert parsed(f"Agent_1 and Agent_2 must lift the barrier together {apart}")


def test_the_lid_of_any_object_can_be_opened():
    words = Vocabulary((1, 2), {"Pot_lid": {}, "lid_holder": {}})
    opened = read("Agent_2 must open the pot lid before Agent_1 begins", words)
    assert opened == Before(Step(2, "lift", "Pot_lid"), Step(1))
    with pytest.raises(ArgumentError, match="say what is lifted in place of lid_holder"):
        read("Agent_2 must open the lid holder before Agent_1 begins", words)
