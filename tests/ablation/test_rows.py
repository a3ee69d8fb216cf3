"""Result rows: durable, shared between processes, checked when read."""

import json
import logging
import multiprocessing
import random
import resource
import zlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from rf_exp.ablation import EvaluationRow, GenerationRow, append_row, load, newest, read_rows
from rf_exp.artifacts import plain
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Account, Unmet
from tests.ablation.conftest import failed

GENERATION = GenerationRow(
    task="lift_barrier", constraints="full", brain="scripted", seed=3, success=True, success_paper=True,
    steps=80, attempts=1, wall_s=1.5, version="1", violations=0, contacts=2,
    generator="1.1", commit="0123456789ab+",
)  # fmt: skip
EVALUATION = EvaluationRow(
    task="lift_barrier", arch="separate_local", constraints="full", demos=150, train_seed=0, scene_seed=1000,
    success=False, success_paper=True, steps=400, step_limit=400, violations=2, wall_s=9.0, version="1",
    contacts=1, commit="", account=Account(unmet=(Unmet("lifted", 1.5, 0.1, None, 0.15, "m", True),)),
)  # fmt: skip


OLD = (
    '{"task": "lift_barrier", "constraints": "full", "brain": "scripted", "seed": 3, "success": true, '
    '"success_paper": true, "steps": 80, "attempts": 1, "reason": "", "wall_s": 1.5, "version": "1"}'
)


def test_a_success_with_contact_between_arms_is_refused() -> None:
    assert replace(EVALUATION, success=True, contacts=0).success
    with pytest.raises(ArgumentError, match="contacts of an EvaluationRow is 1 and success is true"):
        replace(EVALUATION, success=True)


def sealed(**changes: object) -> str:
    """A line with other values and a matching checksum, as the docstring of the module says."""
    return signed({**plain(GENERATION), "reason": "", **changes})


def signed(values: Mapping[str, object]) -> str:
    """A line with these keys and a matching checksum."""
    canonical = json.dumps(values, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode()
    return json.dumps({**values, "crc32": f"{zlib.crc32(canonical):08x}"})


def path_of(out: Path) -> Path:
    return out / "results/generate/lift_barrier/full.jsonl"


@pytest.mark.parametrize("row", [GENERATION, EVALUATION])
def test_round_trip(tmp_path: Path, row: GenerationRow | EvaluationRow) -> None:
    path = tmp_path / "new/folder/rows.jsonl"
    append_row(path, row)
    append_row(path, row)
    assert read_rows(path, type(row)) == (row, row)
    written = [json.loads(line) for line in path.read_text().splitlines()]
    assert [list(line) for line in written] == [[*plain(row), "reason", "crc32"]] * 2
    assert [{key: line[key] for key in plain(row)} for line in written] == [plain(row)] * 2
    assert [line["reason"] for line in written] == [row.reason] * 2


def test_the_fields_are_fixed() -> None:
    assert " ".join(asdict(GENERATION)) == (
        "task constraints brain seed success success_paper steps attempts wall_s version "
        "violations contacts generator commit schema disturbance_rad delay_s account variation drawn dialogue"
    )
    assert " ".join(asdict(EVALUATION)) == (
        "task arch constraints demos train_seed scene_seed success success_paper steps "
        "step_limit violations wall_s version contacts commit schema shield interventions "
        "observation disturbance_rad recipe core_s queries account variation drawn"
    )


def test_a_row_without_the_shield_is_refused(tmp_path: Path) -> None:
    values = {k: v for k, v in asdict(EVALUATION).items() if k != "shield"}
    (tmp_path / "rows.jsonl").write_text(
        json.dumps({**values, "reason": "", "crc32": "0"}, default=plain) + "\n"
    )
    with pytest.raises(StageError, match="fields missing: shield"):
        read_rows(tmp_path / "rows.jsonl", EvaluationRow)


@pytest.mark.parametrize("row", [GENERATION, EVALUATION])
def test_rows_of_scenes_with_variation_have_another_identity(
    tmp_path: Path, row: GenerationRow | EvaluationRow
) -> None:
    drawn = replace(row, variation="full", drawn={"table_height_m": 0.01})
    append_row(tmp_path / "rows.jsonl", row)
    append_row(tmp_path / "rows.jsonl", drawn)
    assert read_rows(tmp_path / "rows.jsonl", type(row)) == (row, drawn) and drawn.identity != row.identity


def test_numpy_scalars_become_plain(tmp_path: Path) -> None:
    row = replace(GENERATION, success=np.bool_(True), steps=np.int64(80), wall_s=2)  # pyright: ignore
    append_row(tmp_path / "rows.jsonl", row)
    assert read_rows(tmp_path / "rows.jsonl", GenerationRow) == (replace(GENERATION, wall_s=2.0),)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"success": 1}, r"success of a GenerationRow is 1 \(int\); expected bool"),
        ({"steps": 80.5}, r"steps of a GenerationRow is 80\.5 \(float\); expected int"),
        ({"account": "fell"}, r"account of a GenerationRow is 'fell' \(str\); expected Account"),
        ({"steps": -1}, r"steps of a GenerationRow is -1; expected a finite number >= 0"),
        ({"wall_s": float("nan")}, r"wall_s of a GenerationRow is nan; expected a finite number >= 0"),
    ],
)
def test_a_wrong_value_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        replace(GENERATION, **change)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "Expecting property name"),
        ("[]", "found list, expected an object"),
        (sealed(steps="80"), r"steps of a GenerationRow is '80' \(str\)"),
        (sealed(color=1), "unknown fields: color; available: account, attempts"),
        (sealed(schema=8), "a row of schema 8, made by another version; this version reads schema 9"),
        (sealed(schema=10), "a row of schema 10, made by another version; this version reads schema 9"),
        (sealed(account={"fell": 1}), "can not match"),
        (sealed(account="fell"), "account is 'fell'; expected an object"),
        (
            json.dumps({"task": "lift_barrier"}),
            "fields missing: account, attempts, brain, commit",
        ),
        (OLD, "fields missing: account, commit, contacts, crc32"),
        (
            json.dumps({**plain(GENERATION), "reason": "", "crc32": "00000000"}),
            "damaged or edited: its checksum is",
        ),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = path_of(tmp_path)
    append_row(path, GENERATION)
    with path.open("a") as file:
        file.write(line + "\n")
    append_row(path, GENERATION)
    with pytest.raises(StageError, match=rf"full\.jsonl, line 2: no GenerationRow: .*{message}"):
        read_rows(path, GenerationRow)


def test_an_unfinished_last_line_is_reported_and_then_removed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = path_of(tmp_path)
    append_row(path, GENERATION)
    with path.open("a") as file:
        file.write('{"task": "lift_bar')
    with caplog.at_level(logging.WARNING):
        assert read_rows(path, GenerationRow) == (GENERATION,)
    assert "line 2: unfinished, left by a crash; not counted" in caplog.text
    assert "line 2: unfinished" in load(tmp_path).notes[0]
    append_row(path, replace(GENERATION, seed=4))
    assert [row.seed for row in read_rows(path, GenerationRow)] == [3, 4]


def test_a_whole_line_without_its_end_counts(tmp_path: Path) -> None:
    path = path_of(tmp_path)
    path.parent.mkdir(parents=True)
    path.write_text(sealed())
    assert read_rows(path, GenerationRow) == (GENERATION,)
    append_row(path, replace(GENERATION, seed=4))
    assert [row.seed for row in read_rows(path, GenerationRow)] == [3, 4]


@pytest.mark.slow
def test_every_flipped_bit_is_named_by_file_and_line(tmp_path: Path) -> None:
    """In any line, and in line ends: no row changes or vanishes silently."""
    path = path_of(tmp_path)
    for seed in range(3):
        append_row(path, replace(GENERATION, seed=seed, success=False, account=failed(seed, 1)))
    whole = path.read_bytes()
    rng = random.Random(7)
    for bit in rng.sample(range(8 * len(whole)), 600) + [8 * (len(whole) - 1) + k for k in range(8)]:
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        line = 1 + whole[: bit // 8].count(b"\n")
        with pytest.raises(
            StageError, match=rf"full\.jsonl, line {line}: no GenerationRow: .*remove that line"
        ):
            read_rows(path, GenerationRow)
        with pytest.raises(StageError, match=rf"full\.jsonl, line {line}: "):
            load(tmp_path)
        append_row(path, GENERATION)  # repairs only what a crash leaves
        assert path.read_bytes().startswith(flipped)


def test_any_text_of_a_model_is_stored(tmp_path: Path) -> None:
    """Half a surrogate pair has no encoding in UTF-8, and a language model can send it."""
    row = replace(GENERATION, success=False, account=Account(ended='caf\u00e9 \ud83d "}\n'))
    append_row(tmp_path / "rows.jsonl", row)
    assert read_rows(tmp_path / "rows.jsonl", GenerationRow) == (row,)


def _write_many(path: Path, worker: int) -> None:
    for seed in range(40):
        append_row(path, replace(GENERATION, seed=1000 * worker + seed, account=Account(ended="x" * 500)))


def test_concurrent_writers_lose_nothing(tmp_path: Path) -> None:
    path = path_of(tmp_path)
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_write_many, args=(path, worker)) for worker in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    seeds = [row.seed for row in read_rows(path, GenerationRow)]
    assert sorted(seeds) == sorted(1000 * worker + seed for worker in range(4) for seed in range(40))


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    path = path_of(tmp_path)
    append_row(path, GENERATION)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 10, hard))
    try:
        with pytest.raises(
            StageError, match=r"cannot append a result row to .*full\.jsonl: File too large; make room"
        ):
            append_row(path, GENERATION)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert read_rows(path, GenerationRow) == (GENERATION,)
    append_row(path, replace(GENERATION, seed=4))
    assert [row.seed for row in read_rows(path, GenerationRow)] == [3, 4]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StageError, match=r"cannot append a result row to .*rows\.jsonl: "):
        append_row(tmp_path / "file/rows.jsonl", GENERATION)
    with pytest.raises(StageError, match=r"cannot read result rows from .*nothing\.jsonl: No such file"):
        read_rows(tmp_path / "nothing.jsonl", GenerationRow)


def test_load_gathers_every_file_and_counts_an_attempt_once(tmp_path: Path) -> None:
    path = path_of(tmp_path)
    append_row(path, replace(GENERATION, success=False, account=Account(ended="dropped")))
    append_row(path, GENERATION)
    append_row(path, replace(GENERATION, version="2"))  # another criterion: another attempt
    append_row(tmp_path / "results/evaluate/lift_barrier/separate_local/full-150.jsonl", EVALUATION)
    results = load(tmp_path)
    assert results.generation == (GENERATION, replace(GENERATION, version="2"))
    assert results.evaluation == (EVALUATION,)
    (note,) = results.notes
    assert "repeated with another result, the last one counts: task lift_barrier" in note
    assert load(tmp_path / "nowhere").generation == ()


def test_the_newest_version_is_kept_and_the_others_are_named() -> None:
    rows = [replace(GENERATION, version=version) for version in ("2", "10", "2", "1.9")]
    kept, note = newest(rows)
    assert kept == (rows[1],)
    assert note == "criteria version 10; left out: 1 of version 1.9, 2 of version 2"
    assert newest(rows[:1]) == ((rows[0],), "")
    assert newest([]) == ((), "")
