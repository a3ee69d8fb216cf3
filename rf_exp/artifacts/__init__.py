"""What every artifact has, whatever is in it: who made it and of what, and that it is whole."""

from rf_exp.artifacts.files import (
    configuration_file,
    disk_full,
    keep_text,
    read_json,
    sweep,
    whole,
    write_json,
    write_text,
)
from rf_exp.artifacts.identity import (
    canonical,
    differing,
    digest,
    expect_same,
    leaves,
    plain,
    read_values,
    restored,
    without,
)
from rf_exp.artifacts.lines import append_line, read_lines
from rf_exp.artifacts.locks import hold_folder, locked
from rf_exp.artifacts.pages import rendered
from rf_exp.artifacts.provenance import code, commit, installed

__all__ = [
    "append_line",
    "canonical",
    "code",
    "commit",
    "configuration_file",
    "differing",
    "digest",
    "disk_full",
    "expect_same",
    "hold_folder",
    "installed",
    "keep_text",
    "leaves",
    "locked",
    "plain",
    "read_json",
    "read_lines",
    "read_values",
    "rendered",
    "restored",
    "sweep",
    "whole",
    "without",
    "write_json",
    "write_text",
]
