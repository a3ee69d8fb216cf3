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
from rf_exp.findings import Finding, ParseError, agent_name
from rf_exp.statements.language.base import Statement, Vocabulary, Words, kinds
from rf_exp.statements.language.notation import (
    ANY_AGENT_TOKEN,
    UNITS,
    alternatives,
    compile_pattern,
    matched_groups,
    object_name,
    quantity,
)
from rf_exp.statements.language.verbs import PARTS, VERBS
from rf_exp.types import Kind, Subgoal

MAX_LENGTH = 300  # characters; a constraint is one sentence
_LONGEST_RUN = 8  # longest run of words inside a sentence that is tried as being in the way
_WORD = re.compile(r"[^\W\d_]+")
# Words of a pattern; the second group marks an optional last letter.
_PATTERN_WORD = re.compile(r"\(\?P<\w+>|([a-z]+)(\??)")

_AGENTS = r"(?:agents?|robots?|arms?)"
_AGENT_LIST = re.compile(
    rf"\b(?:the )?{_AGENTS}[ _-]?(\d{{1,3}}(?:(?:, and |, | and |,)\d{{1,3}}(?![\w.]))+)"
    rf"(?! ?(?:{alternatives({unit for known in UNITS.values() for unit in known})})(?!\w))"
)
_SINGLE_AGENT = re.compile(rf"\b(?:the )?(?:{_AGENTS}|robot arm)[ _-]?(\d{{1,3}})\b")
_ANY_AGENT = re.compile(r"\b(?:anybody|anyone|any (?:agent|robot arm|robot|arm))\b")
_AGENT_BY_SIDE = re.compile(r"\bthe (\w+?)(?:most|-hand)? (?:agent|robot arm|robot|arm)\b")
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
_CONTRACTIONS = {"mustn't": "must not", "shouldn't": "should not", "can't": "cannot", "mayn't": "may not"}


@dataclass(frozen=True)
class UnparsedStatement(Statement):
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

    def checked_against(self, vocabulary: Vocabulary) -> Self:
        """Raises ArgumentError that says why it is not understood."""
        raise ParseError(self.why, self.finding)


def read(text: str, vocabulary: Vocabulary, listed_under: Sequence[int] = ()) -> Statement:
    """The statement of a sentence, in the vocabulary of a task.

    `listed_under` are the agents under which an answer lists it, used where it names none. Raises
    ArgumentError when no pattern matches the whole sentence (with the words in the way and the nearest
    sentence that is understood), or when it names an agent, object or point that does not exist (with those
    that do).
    """
    if len(text) > MAX_LENGTH:
        raise ArgumentError(
            f"constraint of {len(text)} characters; a constraint is one sentence of up to {MAX_LENGTH}"
        )
    words = text.rstrip(".! \t\n").split()
    if (match := _match(words, vocabulary)) is None:
        raise _not_understood(text, words, vocabulary)
    kind, parts = match
    return kind.from_words(Words(parts, text, vocabulary, tuple(listed_under))).checked_against(vocabulary)


def read_or_unparsed(
    text: str, vocabulary: Vocabulary, kind: Kind, listed_under: Sequence[int] = ()
) -> Statement:
    """As `read`, but returns an `UnparsedStatement` where that raises."""
    try:
        return read(text, vocabulary, listed_under)
    except ArgumentError as error:
        finding = error.finding if isinstance(error, ParseError) else Finding.UNREAD_CONSTRAINT
        return UnparsedStatement(kind, tuple(listed_under), text, str(error), finding)


def samples() -> Iterator[Statement]:
    """Sample statements of every kind, to show how constraints are written."""
    return (sample for kind in kinds() for sample in kind.samples)


def _normalised(words: Sequence[str], vocabulary: Vocabulary) -> str:
    sentence = " ".join(words).lower().replace("\u2019", "'")
    for contraction, expansion in _CONTRACTIONS.items():
        sentence = re.sub(rf"\b{contraction}\b", expansion, sentence)
    sentence = _AGENT_LIST.sub(lambda match: re.sub(r"(\d+)", r"agent_\1", match[1]), sentence)
    sentence = _ANY_AGENT.sub(ANY_AGENT_TOKEN, _SINGLE_AGENT.sub(r"agent_\1", sentence))

    def numbered(match: re.Match[str]) -> str:
        agent = vocabulary.sides.get(match[1])
        return match[0] if agent is None else f"agent_{agent}"

    return _AGENT_BY_SIDE.sub(numbered, sentence)


def _match(words: Sequence[str], vocabulary: Vocabulary) -> tuple[type[Statement], dict[str, str]] | None:
    sentence = _normalised(words, vocabulary)
    for kind in kinds():
        for pattern in kind.patterns:
            if match := compile_pattern(pattern).fullmatch(sentence):
                return kind, matched_groups(match)
    return None


def _not_understood(text: str, words: Sequence[str], vocabulary: Vocabulary) -> ArgumentError:
    nearest, in_the_way = _nearest_sentence(words, vocabulary)
    why = f"cannot read {in_the_way!r}" if in_the_way else "knows these words, but not in this order"
    if not words:
        why = "finds no words"
    sentence = _normalised(words, vocabulary)
    matching_advice = [advice for pattern, advice in _ADVICE.items() if re.search(pattern, sentence)]
    return ArgumentError(
        f"constraint {text!r} is not understood: the grammar {why}; the nearest that is: {nearest!r}; "
        f"{'; '.join([str(vocabulary), *matching_advice[:1]])}"
    )


def _nearest_sentence(words: Sequence[str], vocabulary: Vocabulary) -> tuple[str, str]:
    """The nearest sentence that is understood, and the words in the way: the end, or a run anywhere."""
    count = len(words)
    tails = [(start, count) for start in range(count - 1, 0, -1)]
    runs = [(k, k + length) for length in range(1, _LONGEST_RUN + 1) for k in range(count - length, -1, -1)]
    for start, end in (*tails, *runs):
        match = _match([*words[:start], *words[end:]], vocabulary)
        kind, parts = match or (None, {})
        objects = (part for key, part in parts.items() if "object" in key)
        if kind and all(vocabulary.find_object(object_name(name)) for name in objects):
            try:
                statement = kind.from_words(Words(parts, "", vocabulary)).checked_against(vocabulary)
            except ArgumentError:
                continue
            return statement.sentence, " ".join(words[start:end])
    task_words = " ".join(
        [*vocabulary.objects, *(point for points in vocabulary.points.values() for point in points)]
    )
    known = _known_words(tuple(kinds()), tuple(VERBS)).union(_WORD.findall(task_words.lower()))
    unknown = [word for word in words if not known.issuperset(_WORD.findall(word.lower()))]
    sentence = [word.lower() for word in words]

    def similarity(sample: str) -> float:
        return SequenceMatcher(None, sample.lower().rstrip(".").split(), sentence).ratio()

    return max((sample.sentence for sample in samples()), key=similarity), " ".join(unknown)


@cache
def _known_words(known: tuple[type[Statement], ...], verbs: tuple[str, ...]) -> frozenset[str]:
    """All words of the patterns, which depend on the verbs."""
    return frozenset(
        word
        for kind in known
        for pattern in kind.patterns
        for written, optional in _PATTERN_WORD.findall(compile_pattern(pattern).pattern)
        for word in (written, written[:-1] if optional else written)
    )


MAX_SUBGOAL_LENGTH = 200  # characters of a subgoal
MAX_HEIGHT_M = 100.0  # far beyond every arm; the planner checks reach
_MAX_QUOTED = 80
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
    match = _SUBGOAL.fullmatch(" ".join(text.split())) if len(text) <= MAX_SUBGOAL_LENGTH else None
    verb = VERBS.get(match["verb"].lower()) if match else None
    where = f"subgoal {text.strip()[:_MAX_QUOTED]!r} of {agent_name(agent)}"
    if match is None or verb is None:
        raise _subgoal_error(f"cannot read {where}; forms: {', '.join(subgoal_forms())}")
    parts = {part: match[part] for part in PARTS if match[part] is not None}
    if missing := [part for part in verb.needs if part not in parts]:
        raise _subgoal_error(f"{where} lacks {' and '.join(missing)}")
    if unexpected := sorted(set(parts).difference(verb.needs, verb.may_have)):
        raise _subgoal_error(
            f"{where} has {' and '.join(unexpected)}, which {verb.name} has no use for; "
            f"forms: {', '.join(subgoal_forms())}"
        )
    height_m = None
    if "height_m" in parts:
        height_m = quantity("m", parts.pop("height_m"), match["unit"].casefold())
        if height_m >= MAX_HEIGHT_M:
            raise _subgoal_error(f"{where} is by {height_m:g} m; expected less than {MAX_HEIGHT_M:g} m")
    subgoal = Subgoal(agent, verb.name, height_m=height_m, **parts)
    if subgoal.object is not None and subgoal.object not in vocabulary.points:
        raise ParseError(
            f"no object {subgoal.object!r} in {where}; available: {', '.join(sorted(vocabulary.points))}",
            Finding.UNKNOWN_OBJECT,
        )
    for name, point in ((subgoal.object, subgoal.point), (subgoal.target, subgoal.target_point)):
        points = vocabulary.points.get(name or "")
        if points is not None and point is not None and point not in points:
            available = ", ".join(sorted(points)) or "none"
            raise ParseError(
                f"{name} has no interaction point {point!r}; available: {available}", Finding.UNKNOWN_POINT
            )
    if subgoal.object is not None and subgoal.point is not None:
        points = vocabulary.points[subgoal.object]
        fitting = [name for name, kind in points.items() if kind == verb.meets]
        if subgoal.point not in fitting:
            raise ParseError(
                f"{where}: the point {subgoal.point} is to {points[subgoal.point]}; points of "
                f"{subgoal.object} to {subgoal.verb} {'with' if verb.meets == 'tool' else 'at'}: "
                f"{', '.join(fitting) or 'none'}",
                Finding.UNKNOWN_POINT,
            )
    return subgoal


def _subgoal_error(message: str) -> ParseError:
    return ParseError(message, Finding.UNREAD_SUBGOAL)
