"""Files of result rows, written by commands or published, and names of files about rollouts.

results/generate/<task>/<constraints>.jsonl                           GenerationRow; disturbed: ..-disturbed,
                                                                      with delay_s=0 ..-disturbed-punctual;
                                                                      of another brain ..-by-<brain>
results/evaluate/<task>/<arch>/<constraints>-<recipe>-<demos>.jsonl   EvaluationRow; shielded: ..-shield

A published file, with .tsv in the place of .jsonl, is a table with tabs between its columns, which pandas
reads with `sep="\\t", comment="#", quoting=csv.QUOTE_NONE`. Lines `# name: JSON` precede it:

# rows: the kind of rows, and the CRC-32 of all bytes below this line
# constant: the fields that all rows share, with their schema
# asked: the configuration by which the policies were to be trained and evaluated
# made, made.0, made.1: provenance of the policies, as far as all training seeds share it, and of each seed
# curves.0: for each policy some training steps, the mean loss since the step before, CPU seconds until then

The columns are the other fields: numbers and words as they are, booleans as 0 or 1, accounts and dialogues as
JSON without the fields that have their defaults.
"""

import json
import logging
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic

from rf_exp.ablation.rows import EvaluationRow, GenerationRow, R, expect_schema, read_jsonl, restore_parts
from rf_exp.artifacts import plain, restored, write_text
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Account, Dialogue
from rf_exp.texts import shown
from rf_exp.types import UNVARIED

log = logging.getLogger(__name__)

PUBLISHED = ".tsv"
FILM, PICTURE = ".mp4", ".png"
SHIELDED = "-shield"  # in the name of a file about shielded rollouts
SEEDS = ("seed", "train_seed", "scene_seed")  # columns of every table
RESTORE = "restore it with git, or publish its rows again"
Curves = Mapping[str, Mapping[str, list[float]]]  # policy -> column -> values at some steps


@dataclass(frozen=True)
class Results:
    """All rows below an output folder, each attempt once, and notes about irregular files."""

    generation: tuple[GenerationRow, ...] = ()
    evaluation: tuple[EvaluationRow, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Published(Generic[R]):
    """The rows of a published file and, for policies, their requested configuration and provenance."""

    rows: tuple[R, ...]
    asked: Mapping[str, Any] = field(default_factory=dict)
    made: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)  # by training seed
    curves: Mapping[int, Curves] = field(default_factory=dict)  # by training seed


def read_rows(path: Path, kind: type[R]) -> tuple[R, ...]:
    """The rows of one file of either format, in the order they were written.

    Raises StageError naming file and line of a bad row. An unfinished last line, left by a crash, is
    left out with a warning in the log.
    """
    rows, torn = _read(path, kind)
    if torn:
        log.warning(shown(torn))
    return rows


def load(out: Path) -> Results:
    """Every row below `out/results`, of both formats. The last row of a repeated attempt counts.

    Raises StageError for a damaged file, and for published rows with a shield that are of other policies than
    those without.
    """
    notes: list[str] = []

    def gather(kind: type[R], pattern: str) -> tuple[R, ...]:
        latest: dict[tuple[object, ...], R] = {}
        for path in sorted((out / "results").glob(pattern)):
            if path.suffix not in (".jsonl", PUBLISHED):
                continue
            rows, torn = _read(path, kind)
            notes.extend([torn] if torn else [])
            if path.suffix == PUBLISHED and SHIELDED in path.stem:
                _expect_same_policies(path, path.with_name(path.name.replace(SHIELDED, "")))
            for row in rows:
                earlier = latest.pop(row.identity, None)
                if earlier and (earlier.success, earlier.steps) != (row.success, row.steps):
                    attempt = ", ".join(f"{name} {getattr(row, name)}" for name in row.key)
                    notes.append(f"{path}: repeated with another result, the last one counts: {attempt}")
                latest[row.identity] = row
        return tuple(latest.values())

    generation = gather(GenerationRow, "generate/*/*")
    return Results(generation, gather(EvaluationRow, "evaluate/*/*/*"), tuple(notes))


def _expect_same_policies(shielded: Path, without: Path) -> None:
    """Raises StageError where published rows with and without a shield are of different weights."""
    if not without.exists():
        return
    provenances, other_provenances = (
        read_published(path, EvaluationRow).made for path in (shielded, without)
    )
    for seed in {*provenances} & {*other_provenances}:
        if provenances[seed].get("weights") != other_provenances[seed].get("weights"):
            raise StageError(
                f"{shielded} is of other policies than {without} (training seed {seed}): evaluate those with "
                "shield=true and publish their rows, or remove it"
            )


def _read(path: Path, kind: type[R]) -> tuple[tuple[R, ...], str]:
    """The rows of a file, and a note about an unfinished last line, or ""."""
    return (read_published(path, kind).rows, "") if path.suffix == PUBLISHED else read_jsonl(path, kind)


def rows_file(
    task: str,
    constraints: str,
    arch: str,
    recipe: str,
    demos: int,
    shield: bool = False,
    variation: str = UNVARIED,
) -> Path:
    """The file of rows, below the output folder, of policies of all training seeds in varied scenes."""
    name = f"{constraints}-{recipe}-{demos}{_suffix(shield, variation)}.jsonl"
    return Path("results", "evaluate", task, arch, name)


def training_seed_file(rows: Path, seed: int) -> Path:
    """The path of a file about one training seed, beside the file of rows of all seeds."""
    return rows.with_name(f"{rows.stem}-{seed}{rows.suffix}")


def rollout_name(
    arch: str, recipe: str, demos: int, train_seed: int, shield: bool = False, variation: str = UNVARIED
) -> str:
    """The beginning of names of files about a policy's rollouts; `-<scene seed>` follows."""
    seed = f"-t{train_seed}" if train_seed else ""
    return f"evaluate-{arch}-{recipe}-{demos}{seed}{_suffix(shield, variation)}"


def _suffix(shield: bool, variation: str) -> str:
    return SHIELDED * shield + ("" if variation == UNVARIED else f"-in-{variation}")


def rollout_file(row: EvaluationRow, suffix: str) -> Path:
    """The file about a rollout, below the output folder."""
    parts = row.demos, row.train_seed, row.shield, row.variation
    name = rollout_name(row.arch, row.recipe, *parts)
    return Path("recordings", row.task, row.constraints, f"{name}-{row.scene_seed}{suffix}")


def seeds_to_film(rows: Sequence[EvaluationRow], count: int) -> tuple[int, ...]:
    """Scene seeds of the first `count` successes and of as many failures, of different kinds first."""
    ordered = sorted(rows, key=lambda row: row.scene_seed)
    successes = [row.scene_seed for row in ordered if row.success]
    failures = [
        row for row in ordered if not row.success and row.steps
    ]  # without steps there is nothing to see
    kinds = {row.account.kind: row.scene_seed for row in reversed(failures)}
    first = sorted(kinds.values())
    others = [row.scene_seed for row in failures if row.scene_seed not in first]
    return (*successes[:count], *[*first, *others][:count])


def write_published(path: Path, published: Published[Any]) -> None:
    """Writes a published file of at least one row, whole. Raises OSError where it cannot be written."""
    kind = type(published.rows[0])
    rows = [
        {each.name: _without_defaults(getattr(row, each.name)) for each in fields(kind)}
        for row in published.rows
    ]
    constant = {name: value for name, value in _shared(rows).items() if name not in SEEDS}
    shared = _shared([*published.made.values()])
    header = {"constant": constant, "asked": published.asked, "made": shared}
    header = {name: value for name, value in header.items() if value}
    for seed, made in published.made.items():
        header[f"made.{seed}"] = {name: value for name, value in made.items() if name not in shared}
    header |= {f"curves.{seed}": curves for seed, curves in published.curves.items()}
    columns = [name for name in rows[0] if name not in constant]
    lines = [f"# {name}: {json.dumps(value)}" for name, value in header.items()]
    lines += ["\t".join(columns), *("\t".join(_cell(row[name]) for name in columns) for row in rows)]
    below = "\n".join([*lines, ""])
    write_text(path, f"{_checksum_line(kind, below.encode())}\n{below}")


def read_published(path: Path, kind: type[R]) -> Published[R]:
    """A published file. Raises StageError for one that is damaged, edited, or of another kind or schema."""
    try:
        first, _, below = path.read_bytes().partition(b"\n")
    except OSError as error:
        raise StageError(f"cannot read result rows from {path}: {error.strerror or error}") from error
    try:
        if (line := first.decode(errors="replace")) != (sealed := _checksum_line(kind, below)):
            raise ValueError(f"damaged or edited: it begins with {line[:100]!r}; expected {sealed!r}")
        return _parse_published(below.decode(), kind)
    except (ValueError, ArgumentError) as error:
        raise StageError(f"{path}: no published {kind.__name__}s: {error}; {RESTORE}") from error


def _checksum_line(kind: type, below: bytes) -> str:
    """The first line of a published file, with the checksum of all bytes below it."""
    return f'# rows: {{"kind": "{kind.__name__}", "crc32": "{zlib.crc32(below):08x}"}}'


def _parse_published(below: str, kind: type[R]) -> Published[R]:
    lines = below.split("\n")
    header = {}
    while lines[0].startswith("# "):
        name, _, value = lines.pop(0)[2:].partition(": ")
        header[name] = json.loads(value)
    constant = header["constant"]
    expect_schema(constant)
    constant |= restore_parts(constant)
    columns, *table = (line.split("\t") for line in lines[:-1])
    readers = [_READERS[each.type] for name in columns for each in fields(kind) if each.name == name]
    rows = []
    for line in table:
        values = {name: read(cell) for name, read, cell in zip(columns, readers, line, strict=True)}
        rows.append(kind(**constant, **values))
    provenances = {seed: header.get("made", {}) | values for seed, values in _by_seed(header, "made").items()}
    return Published(tuple(rows), header.get("asked", {}), provenances, _by_seed(header, "curves"))


def _by_seed(header: Mapping[str, Any], name_part: str) -> dict[int, Any]:
    prefix = f"{name_part}."
    return {int(name.removeprefix(prefix)): header[name] for name in header if name.startswith(prefix)}


def _shared(mappings: Collection[Mapping[str, Any]]) -> dict[str, Any]:
    first = next(iter(mappings), {})
    return {name: value for name, value in first.items() if all(each.get(name) == value for each in mappings)}


def _without_defaults(value: object) -> Any:
    """A value as plain values; dataclasses without the fields that have their defaults."""
    if is_dataclass(value):
        values = {each.name: (each, getattr(value, each.name)) for each in fields(value)}
        return {
            name: _without_defaults(content)
            for name, (each, content) in values.items()
            if content != _default(each)
        }
    return [_without_defaults(each) for each in value] if isinstance(value, tuple) else plain(value)


def _default(spec: Field[Any]) -> object:
    return spec.default if spec.default_factory is MISSING else spec.default_factory()


def _cell(value: object) -> str:
    if isinstance(value, dict):
        return json.dumps(value)
    return str(int(value)) if isinstance(value, bool) else str(value)


@lru_cache(maxsize=256)
def _account(cell: str) -> Account:
    return restored(Account, json.loads(cell))


_READERS: Mapping[Any, Any] = {
    bool: {"0": False, "1": True}.__getitem__,
    int: int,
    float: float,
    str: str,
    Account: _account,
    Dialogue: lambda cell: restored(Dialogue, json.loads(cell)),
    dict: json.loads,
}
