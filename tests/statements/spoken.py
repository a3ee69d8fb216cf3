"""Sentences that a form reads, drawn from its own pattern: its choices, with optional words or without."""

import random
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rf_exp.statements import kinds
from rf_exp.statements.language.notation import compile_pattern

OBJECTS = ("lid", "the lid", "steak", "the steak", "its pot", "a pot")
AGENTS = ("Agent_1 and Agent_2", "Agent_2, Agent_1", "Agents 1 and 2", "agent_2, and agent_1")
NUMBERS = ("0.5", "2", "10", "+.1", "1e-1", "15.", "100")
WORDS: Mapping[str, tuple[str, ...]] = {  # for the parts of a pattern that any word may be
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
    """A word or letter, a part that any word may be, or a choice; perhaps optional."""

    text: str = ""
    any_of: str = ""  # a key of WORDS
    choices: tuple[tuple["Part", ...], ...] = ()
    optional: bool = False

    def said(self, rng: random.Random) -> str:
        if self.optional and rng.random() < 0.5:
            return ""
        if self.any_of:
            return rng.choice(WORDS[self.any_of])
        return self.text + (said(rng.choice(self.choices), rng) if self.choices else "")


def said(parts: tuple[Part, ...], rng: random.Random) -> str:
    return "".join(part.said(rng) for part in parts)


class _Pattern:
    """The parts of a pattern: words, groups, choices and question marks, and no more than that."""

    def __init__(self, pattern: str) -> None:
        self._left = pattern

    def choices(self) -> tuple[tuple[Part, ...], ...]:
        found: list[list[Part]] = [[]]
        while self._left and not self._left.startswith(")"):
            if self._take("|"):
                found.append([])
                continue
            part = self._part()
            found[-1].append(Part(part.text, part.any_of, part.choices, self._take("?")))
        return tuple(map(tuple, found))

    def _part(self) -> Part:
        if named := re.match(r"\(\?P<(\w+?)__\d+>", self._left):
            *key, name = named[1].split("_")
            if name in WORDS:
                self._drop_group()
                return Part(any_of="other" if name == "agent" and key not in ([], ["then"]) else name)
            self._left = self._left[named.end() :]
            return self._group()
        if self._take("(?:"):
            return self._group()
        letter = re.match(r"\\?(.)", self._left)
        assert letter and letter[0] not in "([*+{.", self._left  # what a pattern has no use for
        self._left = self._left[letter.end() :]
        return Part(letter[1])

    def _group(self) -> Part:
        part = Part(choices=self.choices())
        assert self._take(")")
        return part

    def _drop_group(self) -> None:
        depth, at = 0, 0
        while True:
            depth += {"(": 1, ")": -1}.get(self._left[at], 0)
            at += 2 if self._left[at] == "\\" else 1
            if depth == 0:
                self._left = self._left[at:]
                return

    def _take(self, what: str) -> bool:
        taken = self._left.startswith(what)
        self._left = self._left.removeprefix(what)
        return taken


def forms() -> Iterator[tuple[str, tuple[Part, ...]]]:
    """The pattern of every form of every kind, under a name."""
    for kind in kinds():
        for number, pattern in enumerate(kind.patterns):
            yield (
                f"{kind.__name__} {number}",
                (Part(choices=_Pattern(compile_pattern(pattern).pattern).choices()),),
            )
