"""What a log without a terminal shows of long work, and curves read while they are written."""

import re
import sys
from dataclasses import asdict

import pytest
from rich.console import Console

from rf_exp import progress
from rf_exp.policy import Curve
from rf_exp.progress import Progress
from rf_exp.stages.logs import Follower


def test_the_end_is_said_once_with_rate_and_note(capsys):
    with Progress("bake", 3, "loaves") as bar:
        for made in range(1, 4):
            bar.advance(note=f"{made} of {made} rose")
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("bake: 3/3 loaves at ") and line.endswith("3 of 3 rose")


def test_long_work_says_something_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(progress, "PRINT_INTERVAL_S", 0.0)
    with Progress("bake", 2, "loaves") as bar:
        bar.advance()
        bar.advance()
    assert [line.split()[1] for line in capsys.readouterr().out.splitlines()] == ["1/2", "2/2"]


def test_an_error_is_no_end(capsys):
    with pytest.raises(ValueError), Progress("bake", 2, "loaves") as bar:
        bar.advance()
        raise ValueError("burnt")
    assert capsys.readouterr().out == ""


MARKUP = "[bold]grasp[/bold] [/nonsense] [link=http://x.test]y[/link] :boom: [1, 2]"


@pytest.mark.parametrize("terminal", [False, True])
def test_what_a_model_said_is_text_and_never_markup(terminal, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    progress.console.print(f"seed 3 failed: {MARKUP}")
    with Progress(f"bake {MARKUP}", 1, "loaves") as bar:
        bar.advance(note=MARKUP)
    said = capsys.readouterr().out
    assert f"seed 3 failed: {MARKUP}" in said and f"bake {MARKUP}" in said and said.count(MARKUP) >= 3


@pytest.mark.parametrize("columns", [60, 80])
def test_a_narrow_terminal_keeps_counts_and_the_time_that_is_left(columns, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    # Not by COLUMNS alone, which a console keeps from when it was made.
    monkeypatch.setattr(progress, "console", Console(width=columns))
    monkeypatch.setenv("TERM", "xterm")
    with Progress("evaluate three_robots_stack_cube/full/separate_local, shielded", 2000, "scenes") as bar:
        bar.advance(1500, note="1480 of 1500 scenes succeeded")
        bar.advance(1)
        shown = bar._bar
        assert shown is not None
        shown.refresh()
    said = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    frames = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "\n", said)  # the cursor goes back: another one begins
    drawn = [line for line in frames.splitlines() if "1501/2000" in line and "━" in line]
    assert drawn and all(re.search(r"1501/2000 +(--:--|\d\d:\d\d)", line) for line in drawn)
    assert [line for line in drawn if len(line) > columns or "…" not in line] == []


HEAD = "step,steps,epoch,loss,learning_rate,samples_per_s,core_s\n"


def test_a_follower_reads_whole_new_rows_only(tmp_path):
    path, seen = tmp_path / "curves.csv", []
    path.write_text(HEAD + "10,100,0,0.9,0.001,50.0,1.0\n")  # of an earlier run
    follower = Follower(path, lambda step, figures: seen.append((step, figures)))
    assert list(follower.new()) == []
    path.write_text(path.read_text() + "20,100,0,0.5,0.001,60.0,2.0\n30,100,0,0.4")
    assert [(curve.step, steps) for curve, steps in follower.new()] == [(20, 10)]
    path.write_text(path.read_text() + ",0.001,60.0,3.0\n")
    assert [(curve.step, steps) for curve, steps in follower.new()] == [(30, 10)]
    assert seen[-1] == (30, asdict(Curve(30, 100, 0, 0.4, 0.001, 60.0, 3.0)))


def test_a_follower_waits_for_a_file_that_is_not_there_yet(tmp_path):
    assert list(Follower(tmp_path / "curves.csv", print).new()) == []
