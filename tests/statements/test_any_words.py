"""Sentences with additional words, filler words, and hostile text: the meaning never changes."""

from contextlib import suppress

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from rf_exp.errors import ArgumentError
from rf_exp.statements import read
from tests.statements.sentences import FOOD, LOGICAL, SPATIAL, TEMPORAL, check_code

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


@pytest.mark.slow
@settings(max_examples=600, deadline=5000)
@given(
    words=st.sampled_from(UNDERSTOOD),
    at=st.integers(0, 30),
    inserted=st.sampled_from(CONTENT.split())
    | st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=9),
)
def test_an_additional_content_word_is_refused(words, at, inserted):
    """A content word inserted anywhere into an understood sentence is never ignored."""
    assume(inserted.lower() not in FILLERS.split() and not set(inserted) <= set(".! "))
    at = min(at, len(words))
    with pytest.raises(ArgumentError, match="constraint"):
        check_code(" ".join([*words[:at], inserted, *words[at:]]))


@pytest.mark.slow
def test_fillers_do_not_change_the_meaning():
    for words, (_, code) in zip(UNDERSTOOD, [*LOGICAL, *TEMPORAL, *SPATIAL], strict=True):
        for at in range(len(words) + 1):
            for filler in ("the", "its", "both", "any", "all", "only", "up", "may", "can", "must"):
                text = " ".join([*words[:at], filler, *words[at:]])
                with suppress(ArgumentError):
                    assert check_code(text) == code, text


WORDS = (
    "Agent_1 Agent_2 Agent_99 agent must grasp lift before after and , the of steak lid zone ( ) to "
    "simultaneously within 1e999 -0 nan inf s other agents not avoid collision between ; __import__('os') "
    "{0} %s \\ \x00 \n"
)
HOSTILE = st.one_of(
    st.text(max_size=400), st.lists(st.sampled_from(WORDS.split(" ")), max_size=25).map(" ".join)
)


@pytest.mark.slow
@settings(max_examples=400, deadline=5000)
@given(HOSTILE)
@example("__import__('os').system('touch /tmp/owned')")
@example("Agent_1 must finish within 1e999 s.")
@example("Agent_" + "9" * 200 + " must finish within 1 s.")
@example("Agent_1" + " and Agent_1" * 23 + " must")
@example("the " * 70)
def test_hostile_text_is_refused_or_understood_but_never_executed(text):
    try:
        stated = read(text, FOOD.vocabulary, (1, 2))
    except ArgumentError as error:
        assert str(error)
    else:
        assert read(stated.sentence, FOOD.vocabulary) == stated
