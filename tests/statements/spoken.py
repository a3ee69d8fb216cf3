"""Random sentences generated from the patterns of all forms: choices, with and without optional words."""

import random
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rf_exp.statements import kinds
from rf_exp.statements.language.notation import compile_pattern

OBJECTS = ("lid", "the lid", "steak", "the steak", "its pot", "a pot")
AGENTS = ("Agent_1 and Agent_2", "Agent_2, Agent_1", "Agents 1 and 2", "agent_2, and agent_1")
NUMBERS = ("0.5", "2", "10", "+.1", "1e-1", "15.", "100")
WORDS: Mapping[str, tuple[str, ...]] = {  # for the parts of a pattern that accept any word
    "agent": ("Agent_1", "robot 1", "Agent_1"),
    "other": ("Agent_2", "arm 2", "the right arm"),
    "agents": AGENTS,
    "object": OBJECTS,
    "surface": ("table", "the table", "the pot"),
    "point": ("knob", "center", "inside"),
    "low": ("(0, 0, 0)", "(-.1, 1e-1, +0.2)"),
    "high": ("(1, 1, 1)", "(2, 0.5, -1)"),
    **dict.fromkeys(("s", "m", "deg", "speed"), NUMBERS),
}


@dataclass(frozen=True)
class Part:
    """Part of a pattern: a letter, a part that accepts any word, or a choice; possibly optional."""

    text: str = ""
    word_key: str = ""  # a key of WORDS
    choices: tuple[tuple["Part", ...], ...] = ()
    optional: bool = False

    def sample_text(self, rng: random.Random) -> str:
        if self.optional and rng.random() < 0.5:
            return ""
        if self.word_key:
            return rng.choice(WORDS[self.word_key])
        return self.text + (sample_text(rng.choice(self.choices), rng) if self.choices else "")


def sample_text(parts: tuple[Part, ...], rng: random.Random) -> str:
    return "".join(part.sample_text(rng) for part in parts)


class _PatternParser:
    """Parser of patterns, which consist of letters, groups, choices and question marks only."""

    def __init__(self, pattern: str) -> None:
        self._rest = pattern

    def choices(self) -> tuple[tuple[Part, ...], ...]:
        found: list[list[Part]] = [[]]
        while self._rest and not self._rest.startswith(")"):
            if self._take("|"):
                found.append([])
                continue
            part = self._part()
            found[-1].append(Part(part.text, part.word_key, part.choices, self._take("?")))
        return tuple(map(tuple, found))

    def _part(self) -> Part:
        if named := re.match(r"\(\?P<(\w+?)__\d+>", self._rest):
            *key, name = named[1].split("_")
            if name in WORDS:
                self._drop_group()
                return Part(word_key="other" if name == "agent" and key not in ([], ["then"]) else name)
            self._rest = self._rest[named.end() :]
            return self._group()
        if self._take("(?:"):
            return self._group()
        letter = re.match(r"\\?(.)", self._rest)
        assert letter and letter[0] not in "([*+{.", self._rest  # not used in patterns
        self._rest = self._rest[letter.end() :]
        return Part(letter[1])

    def _group(self) -> Part:
        part = Part(choices=self.choices())
        assert self._take(")")
        return part

    def _drop_group(self) -> None:
        depth, at = 0, 0
        while True:
            depth += {"(": 1, ")": -1}.get(self._rest[at], 0)
            at += 2 if self._rest[at] == "\\" else 1
            if depth == 0:
                self._rest = self._rest[at:]
                return

    def _take(self, prefix: str) -> bool:
        taken = self._rest.startswith(prefix)
        self._rest = self._rest.removeprefix(prefix)
        return taken


def forms() -> Iterator[tuple[str, tuple[Part, ...]]]:
    """Name and pattern of every form of every kind of statement."""
    for kind in kinds():
        for number, pattern in enumerate(kind.patterns):
            yield (
                f"{kind.__name__} {number}",
                (Part(choices=_PatternParser(compile_pattern(pattern).pattern).choices()),),
            )
