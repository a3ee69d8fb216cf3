"""Ten thousand sentences with a word dropped, added or moved: each becomes the right statement or is refused.

`second_reading`, an independent reading of words and their order, judges which statement is right.
"""

import random

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import read, samples
from rf_exp.statements.language import reading
from tests.statements.second_reading import misread
from tests.statements.sentences import ENGLISH, FOOD, LOGICAL, SPATIAL, TEMPORAL

MUTANTS = 10_000
SENTENCES = [text for text, _ in [*LOGICAL, *TEMPORAL, *SPATIAL]] + [*ENGLISH]
SENTENCES += [each.sentence for each in samples() if "barrier" not in each.sentence and 3 not in each.agents]
APPENDED = (
    "while until unless except without not never maybe slowly twice if possible otherwise instead lid "
    "steak pot Agent_1 Agent_2 100 -1 m s within before after then first wait table zone lifting lift "
    "place together simultaneously vertical level and or only the it may can must 2"
)


def mutant(rng: random.Random) -> tuple[str, str]:
    """An understood sentence and a mutant of it."""
    sentence = rng.choice(SENTENCES)
    words = sentence.rstrip(".").split()
    for _ in range(rng.choice((1, 1, 1, 2))):
        at = rng.randrange(len(words))
        match rng.randrange(4):
            case 0 if len(words) > 1:
                del words[at]
            case 1:
                words.insert(at, words[at])
            case 2:
                other = rng.randrange(len(words))
                words[at], words[other] = words[other], words[at]
            case _:
                words.insert(rng.choice((at, len(words))), rng.choice(APPENDED.split()))
    return sentence, " ".join(words)


def test_the_second_reading_accepts_all_understood_sentences():
    assert {text: misread(text, read(text, FOOD.vocabulary)) for text in SENTENCES} == dict.fromkeys(
        SENTENCES, ""
    )


@pytest.mark.slow
def test_no_mutant_is_misread(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reading, "_not_understood", lambda text, *_: ArgumentError(text))
    rng, wrong, understood = random.Random(0), {}, 0
    for _ in range(MUTANTS):
        _, text = mutant(rng)
        try:
            stated = read(text, FOOD.vocabulary, (1, 2))
        except ArgumentError:
            continue
        understood += 1
        if error := misread(text, stated):
            wrong[text] = f"{error}: {stated.sentence}"
    assert not wrong
    assert understood > MUTANTS / 50  # otherwise the test would prove nothing
