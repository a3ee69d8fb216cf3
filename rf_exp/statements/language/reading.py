"""Parser of English sentences into statements, and of lines into subgoals.

A sentence is matched by patterns and never executed. It is understood or refused as a whole: one that no
pattern matches from the first word to the last is refused, with the words that are in the way. Only what has
no meaning is optional: articles, `both`, case, the closing full stop. May, can and could do not mean must.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from typing import Self

from rf_exp.errors import ArgumentError
from rf_exp.findings import Finding, Misread, agent_name
from rf_exp.statements.language.base import Statement, Vocabulary, Words, kinds
from rf_exp.statements.language.notation import (
    ANYBODYS,
    UNITS,
    alternatives,
    compiled,
    found,
    object_name,
    quantity,
)
from rf_exp.statements.language.verbs import PARTS, VERBS
from rf_exp.types import Kind, Subgoal

MAX_LENGTH = 300  # characters; a constraint is one sentence
_LONGEST_RUN = 8  # longest run of words inside a sentence that is tried as being in the way
_WORD = re.compile(r"[^\W\d_]+")
# Words of a pattern; the second group marks an optional last letter.
_WRITTEN = re.compile(r"\(\?P<\w+>|([a-z]+)(\??)")

_AGENTS = r"(?:agents?|robots?|arms?)"
_SEVERAL = re.compile(
    rf"\b(?:the )?{_AGENTS}[ _-]?(\d{{1,3}}(?:(?:, and |, | and |,)\d{{1,3}}(?![\w.]))+)"
    rf"(?! ?(?:{alternatives({unit for known in UNITS.values() for unit in known})})(?!\w))"
)
_ONE = re.compile(rf"\b(?:the )?(?:{_AGENTS}|robot arm)[ _-]?(\d{{1,3}})\b")
_ANYBODY = re.compile(r"\b(?:anybody|anyone|any (?:agent|robot arm|robot|arm))\b")
_SIDE = re.compile(r"\bthe (\w+?)(?:most|-hand)? (?:agent|robot arm|robot|arm)\b")
# Common wording that no statement covers -> advice on what to write instead.
_ADVICE = {
    r"\b(?:stop(?:s|ped|ping)?|pauses?|halts?)\b": (
        "no plan says when an agent stops: say when it 'has finished', or what it 'has finished' doing"
    ),
    r"(?=.*\b(?:before|after|until|once|then|while|when|as soon as|waits?)\b)"
    r".*\b(?:(?:begin|start|finish|end|complete)(?:s|es|ed|ing)?|began|begun|done)\b": (
        "an order is between what is over and what begins: say 'Agent_2 must complete its task before "
        "Agent_1 begins.'"
    ),
    r"\b(?:vertical|horizontal|perpendicular)(?:ly)?\b|\bfrom (?:above|the side)\b": (
        "of a thing say 'Agent_1 must keep lid level.', of a gripper 'The gripper of Agent_1 must be "
        "vertical at lid when lifting it.'"
    ),
}
_SHORT = {"mustn't": "must not", "shouldn't": "should not", "can't": "cannot", "mayn't": "may not"}


@dataclass(frozen=True)
class Unread(Statement):
    """A sentence that is not understood: its text, and the reason."""

    kind: Kind  # pyright: ignore[reportIncompatibleVariableOverride]
    filed: tuple[int, ...]  # the agents under which it is listed
    text: str
    why: str
    finding: Finding = Finding.UNREAD_CONSTRAINT

    @property
    def agents(self) -> tuple[int, ...]:
        return self.filed

    @property
    def sentence(self) -> str:
        return self.text

    def known_in(self, vocabulary: Vocabulary) -> Self:
        """Raises ArgumentError that says why it is not understood."""
        raise Misread(self.why, self.finding)


def read(text: str, vocabulary: Vocabulary, filed: Sequence[int] = ()) -> Statement:
    """The statement of a sentence, in the vocabulary of a task.

    `filed` are the agents under which an answer lists it, used where it names none. Raises ArgumentError when
    no pattern matches the whole sentence (with the words in the way and the nearest sentence that is
    understood), or when it names an agent, object or point that does not exist (with those that do).
    """
    if len(text) > MAX_LENGTH:
        raise ArgumentError(
            f"constraint of {len(text)} characters; a constraint is one sentence of up to {MAX_LENGTH}"
        )
    words = text.rstrip(".! \t\n").split()
    if (matched := _read(words, vocabulary)) is None:
        raise _not_understood(text, words, vocabulary)
    kind, parts = matched
    return kind.reading(Words(parts, text, vocabulary, tuple(filed))).known_in(vocabulary)


def understood(text: str, vocabulary: Vocabulary, kind: Kind, filed: Sequence[int] = ()) -> Statement:
    """As `read`, but returns an `Unread` where that raises."""
    try:
        return read(text, vocabulary, filed)
    except ArgumentError as error:
        finding = error.finding if isinstance(error, Misread) else Finding.UNREAD_CONSTRAINT
        return Unread(kind, tuple(filed), text, str(error), finding)


def samples() -> Iterator[Statement]:
    """Sample statements of every kind, to show how constraints are written."""
    return (sample for kind in kinds() for sample in kind.samples)


def _normal(words: Sequence[str], vocabulary: Vocabulary) -> str:
    sentence = " ".join(words).lower().replace("\u2019", "'")
    for short, long in _SHORT.items():
        sentence = re.sub(rf"\b{short}\b", long, sentence)
    sentence = _SEVERAL.sub(lambda match: re.sub(r"(\d+)", r"agent_\1", match[1]), sentence)
    sentence = _ANYBODY.sub(ANYBODYS, _ONE.sub(r"agent_\1", sentence))

    def named(match: re.Match[str]) -> str:
        agent = vocabulary.sides.get(match[1])
        return match[0] if agent is None else f"agent_{agent}"

    return _SIDE.sub(named, sentence)


def _read(words: Sequence[str], vocabulary: Vocabulary) -> tuple[type[Statement], dict[str, str]] | None:
    sentence = _normal(words, vocabulary)
    for kind in kinds():
        for pattern in kind.patterns:
            if match := compiled(pattern).fullmatch(sentence):
                return kind, found(match)
    return None


def _not_understood(text: str, words: Sequence[str], vocabulary: Vocabulary) -> ArgumentError:
    nearest, in_the_way = _nearest(words, vocabulary)
    why = f"cannot read {in_the_way!r}" if in_the_way else "knows these words, but not in this order"
    if not words:
        why = "finds no words"
    sentence = _normal(words, vocabulary)
    instead = [advice for said, advice in _ADVICE.items() if re.search(said, sentence)]
    return ArgumentError(
        f"constraint {text!r} is not understood: the grammar {why}; the nearest that is: {nearest!r}; "
        f"{'; '.join([str(vocabulary), *instead[:1]])}"
    )


def _nearest(words: Sequence[str], vocabulary: Vocabulary) -> tuple[str, str]:
    """The nearest sentence that is understood, and the words in the way: the end, or a run anywhere."""
    count = len(words)
    tails = [(start, count) for start in range(count - 1, 0, -1)]
    runs = [(k, k + length) for length in range(1, _LONGEST_RUN + 1) for k in range(count - length, -1, -1)]
    for start, end in (*tails, *runs):
        matched = _read([*words[:start], *words[end:]], vocabulary)
        kind, parts = matched or (None, {})
        things = (part for key, part in parts.items() if "object" in key)
        if kind and all(vocabulary.named(object_name(thing)) for thing in things):
            try:
                statement = kind.reading(Words(parts, "", vocabulary)).known_in(vocabulary)
            except ArgumentError:
                continue
            return statement.sentence, " ".join(words[start:end])
    spoken = " ".join([*vocabulary.objects, *(point for of in vocabulary.points.values() for point in of)])
    known = _known_words(tuple(kinds()), tuple(VERBS)).union(_WORD.findall(spoken.lower()))
    unknown = [word for word in words if not known.issuperset(_WORD.findall(word.lower()))]
    sentence = [word.lower() for word in words]

    def likeness(sample: str) -> float:
        return SequenceMatcher(None, sample.lower().rstrip(".").split(), sentence).ratio()

    return max((sample.sentence for sample in samples()), key=likeness), " ".join(unknown)


@cache
def _known_words(known: tuple[type[Statement], ...], verbs: tuple[str, ...]) -> frozenset[str]:
    """All words of the patterns, which depend on the verbs."""
    return frozenset(
        word
        for kind in known
        for pattern in kind.patterns
        for written, optional in _WRITTEN.findall(compiled(pattern).pattern)
        for word in (written, written[:-1] if optional else written)
    )


LONGEST = 200  # characters of a subgoal
HIGHEST_M = 100.0  # far beyond every arm; the planner checks reach
_SHOWN = 80
_SUBGOAL = re.compile(
    r"(?P<verb>\w+)"
    r"(?: (?P<object>(?!at\b|to\b|by\b)\w+))?"
    r"(?: at (?P<point>\w+))?"
    r"(?: to (?P<target>\w+)(?: at (?P<target_point>\w+))?)?"
    rf"(?: by (?P<height_m>\d{{1,4}}(?:\.\d{{1,4}})?) ?(?P<unit>{alternatives(UNITS['m'])}))?\.?",
    re.IGNORECASE,
)


def subgoal_forms() -> tuple[str, ...]:
    return tuple(verb.form for verb in VERBS.values())


def read_subgoal(agent: int, text: str, vocabulary: Vocabulary) -> Subgoal:
    """The subgoal of a line. Raises ArgumentError with the forms or names that exist."""
    match = _SUBGOAL.fullmatch(" ".join(text.split())) if len(text) <= LONGEST else None
    verb = VERBS.get(match["verb"].lower()) if match else None
    where = f"subgoal {text.strip()[:_SHOWN]!r} of {agent_name(agent)}"
    if match is None or verb is None:
        raise _unread(f"cannot read {where}; forms: {', '.join(subgoal_forms())}")
    said = {part: match[part] for part in PARTS if match[part] is not None}
    if missing := [part for part in verb.needs if part not in said]:
        raise _unread(f"{where} lacks {' and '.join(missing)}")
    if strange := sorted(set(said).difference(verb.needs, verb.may_have)):
        raise _unread(
            f"{where} has {' and '.join(strange)}, which {verb.name} has no use for; "
            f"forms: {', '.join(subgoal_forms())}"
        )
    height_m = None
    if "height_m" in said:
        height_m = quantity("m", said.pop("height_m"), match["unit"].casefold())
        if height_m >= HIGHEST_M:
            raise _unread(f"{where} is by {height_m:g} m; expected less than {HIGHEST_M:g} m")
    subgoal = Subgoal(agent, verb.name, height_m=height_m, **said)
    if subgoal.object is not None and subgoal.object not in vocabulary.points:
        raise Misread(
            f"no object {subgoal.object!r} in {where}; available: {', '.join(sorted(vocabulary.points))}",
            Finding.UNKNOWN_OBJECT,
        )
    for name, point in ((subgoal.object, subgoal.point), (subgoal.target, subgoal.target_point)):
        points = vocabulary.points.get(name or "")
        if points is not None and point is not None and point not in points:
            available = ", ".join(sorted(points)) or "none"
            raise Misread(
                f"{name} has no interaction point {point!r}; available: {available}", Finding.UNKNOWN_POINT
            )
    if subgoal.object is not None and subgoal.point is not None:
        points = vocabulary.points[subgoal.object]
        fitting = [name for name, kind in points.items() if kind == verb.meets]
        if subgoal.point not in fitting:
            raise Misread(
                f"{where}: the point {subgoal.point} is to {points[subgoal.point]}; points of "
                f"{subgoal.object} to {subgoal.verb} {'with' if verb.meets == 'tool' else 'at'}: "
                f"{', '.join(fitting) or 'none'}",
                Finding.UNKNOWN_POINT,
            )
    return subgoal


def _unread(told: str) -> Misread:
    return Misread(told, Finding.UNREAD_SUBGOAL)
