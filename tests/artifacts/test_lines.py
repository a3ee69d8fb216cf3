"""Lines that are added to a file: a crash costs the last one at most."""

from pathlib import Path

import pytest

from rf_exp.artifacts import append_line, read_lines


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
