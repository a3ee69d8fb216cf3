"""Property of all forms: a sentence is read with its meaning, or refused.

Sentences are sampled from the pattern of every form, and mutated: a word is dropped, doubled, moved or
replaced by one that is easily confused with it. Exhaustive combinations follow: verbs with adverbs, events
with connectives, units with quantities. `second_reading` judges the meaning of each.
"""

import random
from collections.abc import Iterable
from itertools import islice, product

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import Statement, read, read_subgoal
from rf_exp.statements.language import reading
from tests.statements.second_reading import FORMS, UNITS, misread
from tests.statements.sentences import FOOD
from tests.statements.spoken import forms, sample_text

MIN_READ, MAX_SAMPLES = 15, 300  # sentences per form that have to be read, of at most so many samples
MUTATIONS = 8  # mutations per sentence


def phrases(text: str) -> list[str]:
    """Splits a text at its commas."""
    return [" ".join(each.split()) for each in text.split(",")]


CONFUSABLE = (  # groups of words that are easily confused
    "begins, starts, finishes, ends, stops, has finished, has begun, is done, moves",
    "before, after, until, once, unless, while, then, as soon as, except when, without",
    "at least, at most, no more than, less than, more than, exactly, about",
    "must, may, must not, need not, cannot, does not have to, should, might, must only",
    "within, after, in, by, no later than, for, every",
    "vertical, horizontal, level, upright, perpendicular, vertically, horizontally, from above",
    "above, below, over, under, at",
    "faster, slower",
    "lift, remove, open, pick up, take, push, press, hold, keep, drop, put, lifts, removes, lifting",
    "simultaneously, together, at the same time, in turn, of each other, apart, one after the other",
    "avoid, touch, must not touch, out of, enter",
    "and, or, nor, but not",
    "s, ms, minutes, hours, m, cm, mm, inches, millimeters, centimetres, deg, rad, m/s",
    "both, either, neither, respectively, only, also, not",
    "Agent_1, Agent_2, the lid, the steak, the pot, it",
)
GROUPS = [phrases(group) for group in CONFUSABLE]


@pytest.fixture(autouse=True)
def without_nearest_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skips the search for the nearest sentence, which is not part of reading."""
    monkeypatch.setattr(reading, "_not_understood", lambda text, *_: ArgumentError(text))


def parsed(text: str) -> Statement | None:
    try:
        return read(text, FOOD.vocabulary, (1, 2))
    except ArgumentError:
        return None


def count_and_misread(texts: Iterable[str]) -> tuple[int, dict[str, str]]:
    """Number of sentences that are read, and sentence -> error for those that are misread."""
    found = {text: stated for text in texts if (stated := parsed(text)) is not None}
    wrong = {
        text: f"{error}: {each.sentence}" for text, each in found.items() if (error := misread(text, each))
    }
    return len(found), wrong


def sample_sentences() -> list[str]:
    """Sampled sentences of every form that are read."""
    found: list[str] = []
    for name, parts in forms():
        rng = random.Random(name)
        samples = (sample_text(parts, rng) for _ in range(MAX_SAMPLES))
        of_form = list(islice((text for text in samples if parsed(text) is not None), MIN_READ))
        assert of_form, name
        found += of_form
    return found


def mutated(text: str, rng: random.Random) -> str:
    """The sentence with a word dropped, doubled, moved, or replaced by one that is easily confused."""
    words = text.split()
    at, other = rng.randrange(len(words)), rng.randrange(len(words))
    fitting = [(word, group) for group in GROUPS for word in group if f" {word} " in f" {text} "]
    match rng.randrange(5):
        case 0:
            del words[at]
        case 1:
            words.insert(other, words[at])
        case 2:
            words.insert(other, words.pop(at))
        case _ if fitting:
            word, group = rng.choice(fitting)
            return f" {text} ".replace(f" {word} ", f" {rng.choice(group)} ", 1).strip()
        case _:
            pass
    return " ".join(words)


@pytest.mark.slow
def test_sentences_of_all_forms_and_their_mutations_are_not_misread():
    texts, rng = sample_sentences(), random.Random(0)
    assert count_and_misread(texts)[1] == {}
    count, wrong = count_and_misread(mutated(text, rng) for text in texts for _ in range(MUTATIONS))
    assert wrong == {}
    assert count > len(texts) / 2  # otherwise the test would prove little


ADVERBS = phrases("""
    vertically, horizontally, perpendicularly, from above, from the side, from below, level, upright,
    vertical, horizontal, slowly, gently, quickly, straight up, upwards, sideways, diagonally, away,
    off, together, alone, simultaneously, twice, again, at once, carefully, immediately, by 10 cm,
    completely, partly
""")


@pytest.mark.slow
def test_no_verb_has_another_meaning_with_an_adverb():
    verbs = [[form.replace("_", " ") for form in forms] for _, forms in FORMS]
    texts: list[str] = []
    for (base, third, _, participle, gerund), adverb in product(verbs, ADVERBS):
        texts += [
            f"Agent_1 must {base} the lid {adverb}",
            f"Agent_1 {third} the lid {adverb}",
            f"Agent_1 must {adverb} {base} the lid",
            f"Agent_1 must {base} the lid {adverb} within 5 s",
            f"Agent_1 must {base} the lid {adverb} before Agent_2 begins",
            f"Agent_1 and Agent_2 must {base} the lid {adverb}",
            f"Agent_1 must {base} the steak at its center {adverb}",
            f"the gripper of Agent_1 must be {adverb} when {gerund} the lid",
            f"the lid must be {participle} by Agent_1 {adverb} before Agent_2 begins",
        ]
    count, wrong = count_and_misread(texts)
    assert wrong == {}
    assert count > 200


EVENTS = phrases("""
    begins, starts its task, must begin, has begun, finishes, must finish, ends, has finished, is done,
    stops, has stopped, moves, lifts the lid, must lift the lid, has lifted the lid, is lifting the lid,
    may lift the lid, must not lift the lid, begins lifting the lid, starts to lift the lid, finishes
    lifting the lid, has finished lifting the lid, stops lifting the lid, removes the lid, picks up the
    lid
""")
OBJECT_EVENTS = (
    "the lid is lifted by Agent_2",
    "the lid must be lifted by Agent_2",
    "the lid has been lifted by Agent_2",
    "the lid is on the table",
    "the lid must be on the pot",
    "the lid is not on the pot",
)
CONNECTIVES = phrases("""
    before, after, until, once, then, and then, while, when, as soon as, unless, only after, at least 2
    s after, 2 s after, within 2 s after, no later than 2 s after
""")


@pytest.mark.slow
def test_no_event_has_another_meaning_beside_a_connective():
    """Completed and beginning events in every position of an order."""
    first = [*(f"Agent_2 {event}" for event in EVENTS), *OBJECT_EVENTS]
    then = [f"Agent_1 {event.replace('lid', 'steak')}" for event in EVENTS]
    texts = [
        text
        for one, other in product(first, then)
        for text in (
            *(f"{one} {connective} {other}" for connective in ("before", "until", "then")),
            *(f"{other} {connective} {one}" for connective in ("after", "before", "until", "once")),
            f"first {one}, then {other}",
            f"before {other}, {one}",
            f"after {one}, {other}",
        )
    ]
    texts += [
        text
        for one, connective in product(first, CONNECTIVES)
        for other in ("Agent_1 begins", "Agent_1 finishes", "Agent_1 must place the steak", "Agent_1 waits")
        for text in (
            f"{one} {connective} {other}",
            f"{other} {connective} {one}",
            f"{connective} {one}, {other}",
        )
    ]
    zone = "zone (0, 0, 0) to (1, 1, 1)"
    texts += [
        text
        for one in first
        for text in (
            *(
                f"Agent_1 must wait {word} {one}"
                for word in ("until", "before", "2 s after", "at most 2 s after")
            ),
            f"Agent_1 waits until {one} before placing the steak",
            f"Agent_1 waits for {one.replace('Agent_2 ', 'Agent_2 to ').replace('s ', ' ', 1)}",
            *(
                f"Agent_1 must stay out of {zone} {word} {one}"
                for word in ("until", "before", "while", "after")
            ),
            *(f"{one} within {limit}" for limit in ("10 s", "10 s of each other", "at least 10 s")),
            f"Agent_1 and {one} simultaneously within 10 s",
        )
    ]
    count, wrong = count_and_misread(texts)
    assert wrong == {}
    assert count > 200


UNKNOWN_UNITS = phrases("""
    inch, inches, in, ft, feet, km, dm, um, hours, h, days, steps, turns, kg, N, %, rpm, hz, rad/s,
    deg/s, km/h, mph, m/s2, m/min, units, tiles, , ', "
""")
QUANTITIES = {
    "Agent_1 must finish within {}": "s",
    "Agent_1 must lift the lid within {}": "s",
    "Agent_1 must wait {} after Agent_2 lifts the lid": "s",
    "Agent_1 must place the steak at least {} after Agent_2 lifts the lid": "s",
    "Agent_1 and Agent_2 must lift the lid together within {} of each other": "s",
    "Agent_1 and Agent_2 must lift the lid simultaneously, at most {} apart": "s",
    "Agent_1 and Agent_2 must keep their grippers at least {} apart": "m",
    "Agent_1 must stay at least {} away from Agent_2": "m",
    "Agent_1 must keep its gripper below {}": "m",
    "The gripper of Agent_1 must stay above {} over the table": "m",
    "Agent_1 must keep the lid level within {}": "deg",
    "The lid must stay level to within {}": "deg",
    "Agent_1 must not move faster than {}": "m/s",
    "Agent_1 must move at most at {}": "m/s",
}


@pytest.mark.slow
@pytest.mark.parametrize("sentence", QUANTITIES)
def test_each_unit_is_read_where_its_quantity_is_expected(sentence: str):
    """Symbols and words, both spellings, singular and plural: every unit of a quantity in every sentence."""
    amounts = {"s": "0.05", "m": "1", "deg": "1", "m/s": "0.9"}
    for unit, (quantity, scale) in UNITS.items():
        amount = amounts[quantity] if scale >= 1 else "20"
        texts = [sentence.format(f"{amount} {unit}"), sentence.format(f"{amount}{unit}")]
        count, wrong = count_and_misread(texts)
        assert wrong == {}
        assert count == 2 * (quantity == QUANTITIES[sentence]), texts
    assert count_and_misread(sentence.format(f"1 {unit}") for unit in UNKNOWN_UNITS) == (0, {})


def test_each_unit_of_length_is_read_in_a_subgoal():
    for unit, (quantity, scale) in UNITS.items():
        for text in (f"lift lid by {0.25 / scale:g} {unit}", f"Lift lid by {0.25 / scale:g}{unit.upper()}."):
            if quantity == "m":
                assert read_subgoal(2, text, FOOD.vocabulary).height_m == 0.25
            else:
                with pytest.raises(ArgumentError, match="cannot read subgoal"):
                    read_subgoal(2, text, FOOD.vocabulary)
    assert read_subgoal(2, "lift lid by 1 metre\u017f", FOOD.vocabulary).height_m == 1.0  # a long s (U+017F)
    with pytest.raises(ArgumentError, match=r"by 100 m; expected less than 100 m"):
        read_subgoal(2, "lift lid by 100 m", FOOD.vocabulary)
