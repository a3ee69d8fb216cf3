"""Command lines as people and scripts write them: flags anywhere, characters outside of Hydra's grammar."""

import shlex
import sys
import tempfile
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError
from rf_exp.keys import checked_arguments, checked_folder


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["stages=[generate]", "-m", "task=a,b"], ["-m", "stages=[generate]", "task=a,b"]),
        (["~films", "task=a", "-m", "demos=1", "-r"][:4], ["-m", "~films", "task=a", "demos=1"]),
        (["demos=1", "-c", "job", "demos=2"], ["-c", "job", "demos=1", "demos=2"]),
        (
            ["demos=1", "-cd", "a=b", "--resolve", "-c", "all"],
            ["-cd", "a=b", "--resolve", "-c", "all", "demos=1"],
        ),
        (["x=1", "--config-dir=a", "x=1"], ["--config-dir=a", "x=1", "x=1"]),
        (["-sc", "query=bash"], ["-sc", "query=bash"]),
        ([], []),
    ],
)
def test_flags_are_accepted_at_any_place(arguments: list[str], expected: list[str]) -> None:
    assert checked_arguments(arguments) == expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["-m", "-c", "job"],
            "--multirun and --cfg are given, which are two ways to go; leave one of them out",
        ),
        (["demos=3", "--run", "-i"], "--run and --info are given"),
        (["--resolve"], "--resolve is given, which goes with --cfg"),
        (["--demos", "demos=3"], "unrecognized arguments: --demos; --hydra-help says which flags there are"),
        (["-c", "jobs"], "invalid choice: 'jobs' (choose from"),
        (["demos"], "'demos' is not understood; expected key=value, or a flag such as --help"),
        (["=3"], "'=3' is not understood; expected key=value"),
        ([""], "'' is not understood; expected key=value"),
        (
            ["out=~/x"],
            "'out=~/x' is not understood: in the place of ~ the shell has not put your home; write $HOME",
        ),
        (
            ["task=lift_barrier\r"],
            "'task=lift_barrier\\r' ends with a carriage return, as the lines of a script",
        ),
        (
            ["stages=[generate,", "train]"],
            "'stages=[generate,' is not understood; expected a list as in 'stages=[a, b]'",
        ),
        (["picture={width: 64"], "or a mapping as in 'picture={a: 1, b: 2}', in quotes for the shell"),
        (
            ["out=Straße"],
            """'out=Straße' is not understood: 'ß' needs quotes that the shell leaves, as in 'out="S""",
        ),
        (
            ["name=a\u00a0b"],
            "'\\xa0' looks like a space and is none; write one, in quotes",
        ),
        (["out=a=b"], """'=' needs quotes that the shell leaves, as in 'out="a=b"'"""),
        (["out=runs (2)"], """'(' needs quotes that the shell leaves, as in 'out="runs (2)"'"""),
        (
            ['name=the "best"'],
            """'"' needs quotes that the shell leaves, as in 'name='"'"'the "best"'"'"''""",
        ),
    ],
)
def test_arguments_that_hydra_cannot_parse_are_refused_with_advice(
    arguments: list[str], message: str
) -> None:
    with pytest.raises(ArgumentError) as error:
        checked_arguments(arguments)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), min_size=1))
def test_any_value_is_parsed_or_the_advice_is_valid_in_a_shell(
    value: str,
) -> None:
    try:
        checked_arguments([f"name={value}"])
    except ArgumentError as error:
        head, _, command = str(error).partition("as in ")
        if "needs quotes" not in head:
            return
        (advice,) = shlex.split(command)
        assert OverridesParser.create().parse_override(advice).value() == value


@pytest.mark.parametrize(
    ("out", "message"),
    [
        (
            "~/x",
            "out is '~/x', and '~' would be part of the folder's name; in the place of ~ the shell has",
        ),
        (
            "$HOME/x",
            "and '$' would be part of the folder's name; the shell puts a variable there only outside of",
        ),
        ("C:\\data", "and '\\\\' would be part of the folder's name; folders are separated by /"),
        ("outputs\r", "out is 'outputs\\r', and '\\r' would be part of the folder's name; it cannot be seen"),
        ("", "out is ''; expected the name of a folder"),
        (" ", "out is ' '; expected the name of a folder"),
        (5, "out is 5; expected the name of a folder, in quotes if it is a number"),
        (None, "out is None; expected the name of a folder"),
    ],
)
def test_an_unintended_folder_name_is_refused(out: object, message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        checked_folder(out)
    assert message in str(error.value)


@pytest.mark.parametrize("out", ["outputs", "../x", "/tmp/Straße", "a=b (2), [3]", "日本", "it's", "a~"])
def test_unusual_folder_names_are_accepted(out: str) -> None:
    assert checked_folder(out) == out


@pytest.mark.slow
def test_a_refused_command_line_creates_no_files(tmp_path: Path, monkeypatch, capsys) -> None:
    """Neither an unintended folder, be it from a file, nor anything in the temporary folder."""
    (tmp_path / "conf/experiment").mkdir(parents=True)
    (tmp_path / "conf/experiment/mine.yaml").write_text("# @package _global_\nout: ~/results\n")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "here"))
    from rf_exp.run import main

    for arguments, message in (
        (["-m", "-c", "job"], "--multirun and --cfg are given"),
        (["out=C:\\data"], "folders are separated by /"),
        (['out="~/x"'], "in the place of ~ the shell has not put your home"),
        (["out=5"], "out is 5; expected the name of a folder"),
        (["-m", 'out="~/x"', "demos=1,2"], "in the place of ~ the shell has not put your home"),
        (["out=${HOME}"], "hydra.run.dir: Interpolation key 'HOME' not found"),
        ([f"hydra.searchpath=[file://{tmp_path}/conf]", "experiment=mine"], "out is '~/results'"),
        (["--experimental-rerun", "x.pickle"], "--experimental-rerun reads a pickle"),
    ):
        monkeypatch.setattr(sys, "argv", ["rf_exp.run", *arguments])
        GlobalHydra.instance().clear()
        assert run_guarded(main) == 2
        error = capsys.readouterr().err
        assert message in error and error.startswith("wrong argument: ") and error.count("\n") == 1
    assert not list((tmp_path / "here").iterdir())


@pytest.mark.slow
def test_the_multirun_flag_may_come_last(command, tmp_path: Path) -> None:
    result = command("stages=[bake]", f'out="{tmp_path}/Straße (2)"', "-m", "task=lift_barrier,place_food")
    assert "unknown stage 'bake'" in result.stderr  # checked in the first job
    assert list(tmp_path.glob("Straße (2)/runs/*/*/multirun.yaml"))
