"""Result rows: one per attempt, failed ones included; stored below an output folder as a line of JSON each.

A line holds the fields of its row, in their order; then `reason`, a sentence made from them for people, which
no code reads; and `crc32`: eight hexadecimal digits, the CRC-32 of all before it as canonical JSON (UTF-8,
keys sorted, no spaces). The error about a wrong checksum or another schema names the file and the line.
"""

import json
import math
import re
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from rf_exp.artifacts import append_line, canonical, plain, read_lines, restored
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Account, Dialogue
from rf_exp.texts import printable
from rf_exp.types import FOREIGN, UNVARIED

SCHEMA = 9
CHECKSUM, REASON = "crc32", "reason"  # keys of a line, not fields of its row
_ROUNDS = re.compile(r"dagger\d+")  # rounds of correction, in the name of a recipe
FINAL_SEED = 3_000_000  # first scene seed of final figures; lower ones have decided between recipes
_WORD = re.compile(r"[\w.+=-]{0,100}")  # name of a task, a recipe, a version, a commit


@dataclass(frozen=True)
class _Row:
    """Base of rows; checks fields: exactly the declared types, finite numbers >= 0, names of one word."""

    key: ClassVar[tuple[str, ...]]  # fields that identify an attempt

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.generic):
                value = value.item()
            if item.type is float and type(value) is int:
                value = float(value)
            object.__setattr__(self, item.name, value)
            assert isinstance(item.type, type)
            wrong = ""
            if type(value) is not item.type:
                wrong = f"{value!r} ({type(value).__name__}); expected {item.type.__name__}"
            elif isinstance(value, int | float) and not 0 <= value < math.inf:
                wrong = f"{value!r}; expected a finite number >= 0"
            elif isinstance(value, str) and not _WORD.fullmatch(value):
                word = "one word of letters, digits, '_', '-', '+', '=' and '.', at most 100 of them"
                wrong = f"{printable(repr(value), 120)}; expected {word}"
            if wrong:
                raise ArgumentError(f"{item.name} of a {type(self).__name__} is {wrong}")

    @property
    def identity(self) -> tuple[object, ...]:
        """The values of `key`: two rows with one identity are the same attempt, repeated."""
        return tuple(getattr(self, name) for name in self.key)


@dataclass(frozen=True)
class GenerationRow(_Row):
    """One attempt to make a demonstration, in the scene of a seed."""

    key: ClassVar = (
        *("task", "constraints", "brain", "seed", "version", "disturbance_rad", "delay_s", "variation"),
    )
    task: str
    constraints: str
    brain: str  # with the name of its model or fault, if it has one
    seed: int
    success: bool  # strict criterion
    success_paper: bool  # the paper's
    steps: int  # control steps at 20 Hz
    attempts: int  # proposals used
    wall_s: float
    version: str  # of the success criteria
    violations: int  # proposals that ended in a violation
    contacts: int  # control steps in which arms touched each other
    generator: str  # version of the code that decides the bytes of the episode
    commit: str  # git commit of that code, with a + where it was changed since, or its version
    schema: int = SCHEMA
    disturbance_rad: float = 0.0  # of executed motion
    delay_s: float = 0.0  # longest delay of an arm
    account: Account = field(default_factory=Account)  # violations that ended proposals, contacts, failures
    variation: str = UNVARIED  # of the scenes, by its name
    drawn: dict = field(default_factory=dict, hash=False)  # values drawn from it for this scene
    dialogue: Dialogue = field(default_factory=Dialogue)  # RoboBrain's answers

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty when it did not."""
        return "" if self.success else self.account.reason


@dataclass(frozen=True)
class EvaluationRow(_Row):
    """One rollout of policies, in one scene."""

    key: ClassVar = (
        *("task", "arch", "constraints", "demos", "train_seed", "scene_seed", "version", "shield"),
        *("observation", "disturbance_rad", "recipe", "variation"),
    )
    task: str
    arch: str
    constraints: str  # of the demonstrations that the policies learnt from
    demos: int
    train_seed: int
    scene_seed: int
    success: bool  # strict criterion, and no two arms touched
    success_paper: bool  # the paper's
    steps: int  # control steps at 20 Hz
    step_limit: int
    violations: int  # control steps with a violation
    wall_s: float
    version: str  # of the success criteria
    contacts: int  # control steps in which arms touched each other
    commit: str  # git commit of the code, with a + where it was changed since, or its version
    schema: int = SCHEMA
    shield: bool = False  # whether a shield was between policies and arms
    interventions: int = 0  # control steps in which the shield kept an arm from its policy's command
    observation: str = "pictures"  # or state: the policies were given the true poses
    disturbance_rad: float = 0.0  # of the demonstrations that the policies learnt from
    recipe: str = "paper"  # of training, see conf/policy
    core_s: float = 0.0  # CPU seconds of learning, of all policies of the architecture together
    queries: int = 0  # proposals that the expert was asked for to correct them
    account: Account = field(default_factory=Account)  # which arms touched or overlapped, and what failed
    variation: str = UNVARIED  # of the scenes; `recipe` has that of the demonstrations
    drawn: dict = field(default_factory=dict, hash=False)  # values drawn from it for this scene

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.success and self.contacts:
            raise ArgumentError(
                f"contacts of an EvaluationRow is {self.contacts} and success is true; expected no contacts: "
                "strict success asks that no two arms touched"
            )

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty when it did not."""
        return "" if self.success else self.account.reason

    @property
    def final(self) -> bool:
        """Whether the scene is a final one, by which nothing was ever chosen."""
        return self.scene_seed >= FINAL_SEED

    @property
    def score(self) -> float | None:
        """Progress of the rollout, from 0 to 1 (success); None where it was ended before it was judged.

        It is computed from the account, so rows that are older than the score have one too.
        """
        if self.success:
            return 1.0
        return None if self.account.closest is None else self.account.closest.score

    @property
    def learned_on(self) -> str:
        """The variation of the demonstrations, from the name of the recipe: RECIPE+VARIATION+daggerROUNDS."""
        variations = [part for part in self.recipe.split("+")[1:] if not _ROUNDS.fullmatch(part)]
        return "+".join(variations) if variations and self.arch != FOREIGN.name else UNVARIED


R = TypeVar("R", bound=GenerationRow | EvaluationRow)
K = TypeVar("K")


def grouped(rows: Iterable[R], key: Callable[[R], K]) -> dict[K, list[R]]:
    """The rows grouped by `key`, groups in the order of their first rows."""
    groups: dict[K, list[R]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def append_row(path: Path, row: GenerationRow | EvaluationRow) -> None:
    """Appends one row by `append_line`. Raises StageError."""
    values = {**plain(row), REASON: row.reason}
    text = json.dumps({**values, CHECKSUM: _checksum(values)}, ensure_ascii=False)
    try:
        append_line(path, text.encode(errors="surrogatepass"))
    except OSError as error:
        raise StageError(
            f"cannot append a result row to {path}: {error.strerror or error}; "
            "make room or choose another `out`"
        ) from error


def read_jsonl(path: Path, kind: type[R]) -> tuple[tuple[R, ...], str]:
    """The rows of a .jsonl file, in their order, and a note about an unfinished last line, or "".

    Raises StageError naming file and line of a bad row.
    """
    try:
        lines, torn = read_lines(path)
    except OSError as error:
        raise StageError(f"cannot read result rows from {path}: {error.strerror or error}") from error
    rows = []
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(_parse(line, kind))
        except (ValueError, ArgumentError) as error:
            raise StageError(
                f"{path}, line {number}: no {kind.__name__}: {error}; remove that line and run the same "
                "command again, which makes its row anew"
            ) from error
    note = f"{path}, line {len(lines) + 1}: unfinished, left by a crash; not counted" if torn else ""
    return tuple(rows), note


def newest(rows: Iterable[R]) -> tuple[tuple[R, ...], str]:
    """The rows of the newest version of the success criteria, and a note that names the rest.

    Versions are compared part by part as numbers: 2 before 10, 1.9 before 1.10.
    """
    by_version = grouped(rows, lambda row: row.version)
    if not by_version:
        return (), ""
    latest = max(by_version, key=_version_order)
    older = sorted(by_version.keys() - {latest}, key=_version_order)
    listed = ", ".join(f"{len(by_version[version])} of version {version}" for version in older)
    note = f"criteria version {latest}; left out: {listed}" if older else ""
    return tuple(by_version[latest]), note


def _version_order(version: str) -> tuple[tuple[int, int, str], ...]:
    parts = version.replace("-", ".").split(".")
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts)


def _checksum(values: Mapping[str, Any]) -> str:
    return f"{zlib.crc32(canonical(values)):08x}"


def _parse(line: bytes, kind: type[R]) -> R:
    """The row of a line. Raises ValueError or ArgumentError unless intact, with exactly the keys of a row."""
    value = json.loads(line)
    if not isinstance(value, dict):
        raise ValueError(f"found {type(value).__name__}, expected an object")
    if "schema" in value:
        expect_schema(value)
    expected = {*(item.name for item in fields(kind)), REASON, CHECKSUM}
    if missing := sorted(expected - value.keys()):
        raise ValueError(f"fields missing: {', '.join(missing)}")
    if unknown := sorted(value.keys() - expected):
        raise ValueError(f"unknown fields: {', '.join(unknown)}; available: {', '.join(sorted(expected))}")
    recorded = value.pop(CHECKSUM)
    if recorded != (computed := _checksum(value)):
        raise ValueError(f"damaged or edited: its checksum is {computed}, it says {recorded!r}")
    return restore_row(value, kind)


def restore_row(values: Mapping[str, Any], kind: type[R]) -> R:
    """The row of plain values, with or without `reason`.

    Raises ArgumentError for values of another schema or another kind of row.
    """
    expect_schema(values)
    fields_only = {name: value for name, value in values.items() if name != REASON}
    if not isinstance(fields_only.get("account"), dict):
        raise ArgumentError(f"account is {fields_only.get('account')!r}; expected an object")
    parts = restore_parts(fields_only)
    return kind(**fields_only, **parts)


def restore_parts(values: dict[str, Any]) -> dict[str, Any]:
    """The accounts and dialogues among plain values of a row, removed from `values`."""
    kinds = {"account": Account, "dialogue": Dialogue}
    return {name: restored(kind, values.pop(name)) for name, kind in kinds.items() if name in values}


def expect_schema(values: Mapping[str, Any]) -> None:
    """Raises ArgumentError for values of a row of another schema."""
    if (schema := values.get("schema")) != SCHEMA:
        raise ArgumentError(
            f"a row of schema {schema}, made by another version; this version reads schema {SCHEMA}"
        )
