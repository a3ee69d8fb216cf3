"""Ten thousand sentences with a word too few, too many or elsewhere: each the right statement, or refused.

What is right is told by another reading, of words and of their order alone: a bag of the words that mean
something, and who comes first.
"""

import random
import re
from collections import Counter

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import VERBS, Before, Statement, Step, read, reading, samples
from tests.statements.sentences import ENGLISH, FOOD, LOGICAL, SPATIAL, TEMPORAL

MUTANTS = 10_000
SENTENCES = [text for text, _ in [*LOGICAL, *TEMPORAL, *SPATIAL]] + [*ENGLISH]
SENTENCES += [each.sentence for each in samples() if "barrier" not in each.sentence and 3 not in each.agents]
APPENDED = (
    "while until unless except without not never maybe slowly twice if possible otherwise instead lid "
    "steak pot Agent_1 Agent_2 100 -1 m s within before after then first wait table zone lifting lift "
    "place together simultaneously vertical level and or only the it may can must 2"
)

# Words that say nothing of their own where a sentence is understood.
FILLERS = (
    "away over "
    "the a an its their both any all to of at by on for or is are be been has have had was it in with and "
    "that must should shall will needs need may can could allowed gripper hand grippers agents robots "
    "arms point side end handle interaction contact tasks task action actions motion motions work perform "
    "do begin begins start starts proceed acts between other objects obstacles each one least most back "
    "still up only after before until once then first wait waits finished finish finishes complete "
    "completes completed done ends ended stops zone box region area stay stays out keep keeps keeping "
    "kept hold holds avoid collision collisions colliding collide touch touching hit when while as long "
    "there inside into enter enters not never mustn't cannot s sec secs second seconds within apart space "
    "same shared share environment surroundings interfere intersect trajectories trajectory paths occupy "
    "remain remains table lies put robot agent arm"
)
SAME = {
    "perpendicularly": "perpendicular", "vertically": "vertical", "above": "vertical", "from": "",
    "horizontally": "horizontal", "centre": "center", "middle": "center", "heights": "height",
    "equal": "consistent", "identical": "consistent", "concurrently": "simultaneously",
    "time": "simultaneously", "together": "simultaneously", "sync": "simultaneously",
    "maintain": "", "approach": "", "reach": "",
}  # fmt: skip
UNITS, SCALES = r"(\d+(?:\.\d+)?) ?(cm|mm)\b(/s)?", {"cm": 100, "mm": 1000}
VERB_OF = {word: verb.name for verb in VERBS.values() for word in (*verb.finite, *verb.gerunds)}


def names(text: str) -> list[str]:
    """Agents in one spelling, in the order of the text."""
    text = re.sub(r"\b(?:agents?|robots?)[ _](\d) and (\d)\b", r"agent_\1 and agent_\2", text.lower())
    text = re.sub(r"\b(?:agent|robot)[ _](\d)", r"agent_\1", text)
    text = text.replace("the left arm", "agent_1").replace("the right arm", "agent_2")
    text = text.replace("the right robot", "agent_2")
    text = re.sub(r"\blets? go of\b", "releases", text)
    text = re.sub(r"\b(?:all )?agents (must|should|may|can)\b", r"agent_1 and agent_2 \1", text)
    text = re.sub(r"\b(?:one after (?:the other|another)|chronologically)\b", "turns", text)
    text = re.sub(UNITS, lambda found: f"{float(found[1]) / SCALES[found[2]]} m{found[3]}", text)
    text = re.sub(r"\b(?:upright|horizontal)(?= |$)", "level", text) if "gripper" not in text else text
    text = re.sub(r"\b(?:no )?(?:faster|slower) than\b", "", text).replace("degrees", "deg")
    if "height" in text:
        text = re.sub(r"\bsame\b", "consistent", text)
    return re.findall(r"agent_\d|[-+]?\d*\.?\d+(?:e[-+]?\d+)?|[a-z']+", text)


def meaning(text: str) -> Counter[str]:
    """The words of a sentence that mean something, each in one form; numbers by their value."""
    found: Counter[str] = Counter()
    for word in names(text):
        word = SAME.get(word, VERB_OF.get(word, word))
        if re.fullmatch(r"[-+.\de]*\d[-+.\de]*", word):
            word = f"{float(word) + 0.0:g}"
        if word and word not in (*FILLERS.split(), "hold"):
            found[word] += 1
    return found


def waits(text: str) -> bool:
    """Whether what is mentioned first is what has to wait."""
    words = names(text)
    if words[0] in ("after", "once", "first") or words[:2] == ["only", "after"]:
        return False
    if "not" in words or "mustn't" in words or words[0] == "before":
        return True
    if {"wait", "waits"} & set(words):
        return True
    return not ({"before", "then"} & set(words))


def mutant(rng: random.Random) -> tuple[str, str]:
    """A sentence that is understood, and one that came of it."""
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


def misread(text: str, stated: Statement) -> str:
    """What is wrong with the reading of a sentence; empty if nothing is."""
    said, says = meaning(text), meaning(stated.sentence)
    if unread := said - says:
        return f"words that were not read: {dict(unread)}"
    defaults = Counter({"0.1": 1, "simultaneously": 1})
    if "level" in said and "deg" not in said:
        defaults += Counter({"10": 1, "deg": 1})
    if invented := (says - said) - defaults:
        return f"words that are not there: {dict(invented)}"
    if isinstance(stated, Before):
        first = f"agent_{stated.first.agent}" if isinstance(stated.first, Step) else stated.first.object
        then = f"agent_{stated.then.agent}"
        words = names(text)
        if (words.index(then) < words.index(first)) != waits(text):
            return "the wrong one waits"
    return ""


def test_the_other_reading_agrees_on_what_is_understood():
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
        if why := misread(text, stated):
            wrong[text] = f"{why}: {stated.sentence}"
    assert not wrong
    assert understood > MUTANTS / 50  # or this would say nothing
