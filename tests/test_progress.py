"""Progress in logs and terminals, and curves that are read while they are written."""

import re
import sys
from dataclasses import asdict

import pytest
from rich.console import Console

from rf_exp import progress
from rf_exp.policy import Curve
from rf_exp.progress import Progress
from rf_exp.stages.logs import Follower


def test_the_end_is_printed_once_with_rate_and_note(capsys):
    with Progress("bake", 3, "loaves") as bar:
        for count in range(1, 4):
            bar.advance(note=f"{count} of {count} rose")
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("bake: 3/3 loaves at ") and line.endswith("3 of 3 rose")


def test_long_work_prints_at_intervals(capsys, monkeypatch):
    monkeypatch.setattr(progress, "PRINT_INTERVAL_S", 0.0)
    with Progress("bake", 2, "loaves") as bar:
        bar.advance()
        bar.advance()
    assert [line.split()[1] for line in capsys.readouterr().out.splitlines()] == ["1/2", "2/2"]


def test_an_error_prints_no_end(capsys):
    with pytest.raises(ValueError), Progress("bake", 2, "loaves") as bar:
        bar.advance()
        raise ValueError("burnt")
    assert capsys.readouterr().out == ""


MARKUP = "[bold]grasp[/bold] [/nonsense] [link=http://x.test]y[/link] :boom: [1, 2]"


@pytest.mark.parametrize("terminal", [False, True])
def test_texts_of_a_model_are_never_markup(terminal, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    progress.console.print(f"seed 3 failed: {MARKUP}")
    with Progress(f"bake {MARKUP}", 1, "loaves") as bar:
        bar.advance(note=MARKUP)
    output = capsys.readouterr().out
    assert f"seed 3 failed: {MARKUP}" in output and f"bake {MARKUP}" in output and output.count(MARKUP) >= 3


@pytest.mark.parametrize("columns", [60, 80])
def test_a_narrow_terminal_keeps_counts_and_the_remaining_time(columns, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    # COLUMNS is not enough: a console reads it only when it is constructed.
    monkeypatch.setattr(progress, "console", Console(width=columns))
    monkeypatch.setenv("TERM", "xterm")
    with Progress("evaluate three_robots_stack_cube/full/separate_local, shielded", 2000, "scenes") as bar:
        bar.advance(1500, note="1480 of 1500 scenes succeeded")
        bar.advance(1)
        display = bar._bar
        assert display is not None
        display.refresh()
    output = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    frames = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\r", "\n", output)  # the cursor moves back: a new frame
    lines = [line for line in frames.splitlines() if "1501/2000" in line and "━" in line]
    assert lines and all(re.search(r"1501/2000 +(--:--|\d\d:\d\d)", line) for line in lines)
    assert [line for line in lines if len(line) > columns or "…" not in line] == []


HEAD = "step,steps,epoch,loss,learning_rate,samples_per_s,core_s\n"


def test_a_follower_reads_only_complete_new_rows(tmp_path):
    path, reported = tmp_path / "curves.csv", []
    path.write_text(HEAD + "10,100,0,0.9,0.001,50.0,1.0\n")  # of an earlier run
    follower = Follower(path, lambda step, figures: reported.append((step, figures)))
    assert list(follower.new()) == []
    path.write_text(path.read_text() + "20,100,0,0.5,0.001,60.0,2.0\n30,100,0,0.4")
    assert [(curve.step, steps) for curve, steps in follower.new()] == [(20, 10)]
    path.write_text(path.read_text() + ",0.001,60.0,3.0\n")
    assert [(curve.step, steps) for curve, steps in follower.new()] == [(30, 10)]
    assert reported[-1] == (30, asdict(Curve(30, 100, 0, 0.4, 0.001, 60.0, 3.0)))


def test_a_follower_waits_for_a_missing_file(tmp_path):
    assert list(Follower(tmp_path / "curves.csv", print).new()) == []
