"""Lines appended to a file: a crash loses the last one at most."""

import errno
from pathlib import Path

import pytest

from rf_exp.artifacts import append_line, read_lines
from tests.children import small_files


@pytest.mark.parametrize(
    ("content", "lines", "incomplete"),
    [
        (b"", [], False),
        (b"{}\n[1]\n", [b"{}", b"[1]"], False),
        (b"{}\n[1]", [b"{}", b"[1]"], False),  # only the end of the line is missing
        (b'{}\n{"a": ', [b"{}"], True),
        (b"{}\n[1]x", [b"{}", b"[1]x"], False),  # complete but damaged, which the reader must detect
    ],
)
def test_an_incomplete_last_line_is_detected(
    tmp_path: Path, content: bytes, lines: list[bytes], incomplete: bool
) -> None:
    path = tmp_path / "new" / "rows.jsonl"
    path.parent.mkdir()
    path.write_bytes(content)
    assert read_lines(path) == (lines, incomplete)
    append_line(path, b"2")
    assert path.read_bytes().splitlines() == [*lines, b"2"]
    assert read_lines(path) == ([*lines, b"2"], False)


def test_the_first_line_creates_file_and_folder(tmp_path: Path) -> None:
    append_line(tmp_path / "new" / "rows.jsonl", b"{}")
    assert (tmp_path / "new" / "rows.jsonl").read_bytes() == b"{}\n"


def test_a_full_disk_raises_and_leaves_complete_lines(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    append_line(path, b"[1]")
    with small_files(10), pytest.raises(OSError) as error:
        append_line(path, b'["a line that does not fit"]')
    assert error.value.errno == errno.EFBIG
    assert read_lines(path) == ([b"[1]"], True)
    append_line(path, b"[2]")
    assert path.read_bytes() == b"[1]\n[2]\n"
