"""Lines that are added to a file: a crash costs the last one at most."""

import errno
from pathlib import Path

import pytest

from rf_exp.artifacts import append_line, read_lines
from tests.children import small_files


@pytest.mark.parametrize(
    ("left", "lines", "torn"),
    [
        (b"", [], False),
        (b"{}\n[1]\n", [b"{}", b"[1]"], False),
        (b"{}\n[1]", [b"{}", b"[1]"], False),  # only its end is missing
        (b'{}\n{"a": ', [b"{}"], True),
        (b"{}\n[1]x", [b"{}", b"[1]x"], False),  # whole, and damaged: that is for the reader to say
    ],
)
def test_an_unfinished_last_line_is_told_from_a_whole_one(
    tmp_path: Path, left: bytes, lines: list[bytes], torn: bool
) -> None:
    path = tmp_path / "new" / "rows.jsonl"
    path.parent.mkdir()
    path.write_bytes(left)
    assert read_lines(path) == (lines, torn)
    append_line(path, b"2")
    assert path.read_bytes().splitlines() == [*lines, b"2"]
    assert read_lines(path) == ([*lines, b"2"], False)


def test_the_first_line_makes_file_and_folder(tmp_path: Path) -> None:
    append_line(tmp_path / "new" / "rows.jsonl", b"{}")
    assert (tmp_path / "new" / "rows.jsonl").read_bytes() == b"{}\n"


def test_a_disk_that_is_full_says_so_and_the_line_is_there_or_not(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    append_line(path, b"[1]")
    with small_files(10), pytest.raises(OSError) as told:
        append_line(path, b'["a line that does not fit"]')
    assert told.value.errno == errno.EFBIG
    assert read_lines(path) == ([b"[1]"], True)
    append_line(path, b"[2]")
    assert path.read_bytes() == b"[1]\n[2]\n"
