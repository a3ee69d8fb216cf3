"""Every command in README.md, CONTRIBUTING.md and docs/*.md is accepted by its program.

No command runs to its end here: some take days, a GPU or a cluster. The checks of each:

- `python -m rf_exp.run`, `.gallery`, `.demonstration`: Hydra composes the overrides, with `-m` for the
  first and the last job of the sweep, and the experiment is read and checked as in the command. Launchers
  that are not installed (Slurm, Ray) are left out.
- other modules, benchmarks, examples: run until their parser has accepted the arguments; without
  arguments, until their help.
- `make`: a dry run. `pip`: the extra exists. `rerun`, `dask`, `ray`: the subcommand and the options are in
  its help.
- `export`, `ssh` and `eval` are not checked.

Elsewhere, short versions of the examples and of the tutorial run (tests/envs, tests/library, tests/tutorial),
scripts that write documents run and their output is compared (tests/tasks, tests/ablation), and quick runs of
the main command, rf_exp.data, the gallery and the demonstration are in their own tests.
"""

import argparse
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import trimesh
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from rf_exp.command import register_all_tasks
from rf_exp.experiment import read_experiment
from rf_exp.policy.config import PARTS
from rf_exp.release import expand_release
from rf_exp.tasks import assets
from rf_exp.tasks.assets.asset import mesh
from tests.conftest import CONF
from tests.policy.test_release import packed
from tests.policy.test_release import said as released
from tests.tasks import release_assets

ROOT = Path(__file__).parents[1]
DOCUMENTS = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
OTHERS = ("rerun", "dask", "ray")
CLIENT = "rf_exp-client"  # in a separate distribution, and a command of rf_exp
PROGRAMS = ("python", "make", "pip", "rf-exp", CLIENT, "mkdocs", "export", "ssh", "eval", *OTHERS)
HYDRA = {
    "rf_exp.run": "config",
    "rf_exp.gallery": "config",
    "rf_exp.laws": "config",
    "rf_exp.demonstration": "demonstration",
}
pytestmark = pytest.mark.slow

FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHELL = ("sh", "bash")
INLINE = re.compile(r"`([^`\n]+)`")
EXTRAS = re.compile(r"\[([\w,-]+)\]")


def fenced_lines(text: str, languages: tuple[str, ...]) -> list[str]:
    """The lines of fenced code in these languages; continued lines are joined."""
    code = "\n".join(block for language, block in FENCED.findall(text) if language in languages)
    return list[str](code.replace("\\\n", " ").splitlines())


def candidate_lines(text: str) -> list[str]:
    """The lines of a document that may be shell commands: fenced code, and code in backticks."""
    return [*fenced_lines(text, (*SHELL, "")), *INLINE.findall(FENCED.sub("", text))]


def words(line: str) -> list[str]:
    """Program and arguments of a shell line, without leading variables and without a redirection."""
    try:
        parts = shlex.split(line.replace("$PWD", str(ROOT)), comments=True)
    except ValueError:  # not a shell line
        return []
    while parts and re.fullmatch(r"[A-Z_]+=.*", parts[0]):
        parts.pop(0)
    return parts[: parts.index(">")] if ">" in parts else parts


def program(line: str) -> str:
    """Name of the program without its folder; empty if the line is not a command."""
    parts = words(line)
    return parts[0].split("/")[-1] if len(parts) > 1 or parts == ["make"] else ""


def commands() -> list[str]:
    """All distinct commands of all documents, as written."""
    distinct = dict.fromkeys(
        line.strip() for path in DOCUMENTS for line in candidate_lines(path.read_text("utf-8"))
    )
    return [line for line in distinct if program(line) in PROGRAMS]


COMMANDS = commands()


def commands_of(name: str) -> list[str]:
    return [line for line in COMMANDS if program(line) == name]


def is_hydra(line: str) -> bool:
    parts = words(line)
    return parts[1] == "-m" and parts[2] in HYDRA


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the documents presuppose: annotated mesh, recorded answers, releases."""
    root = tmp_path_factory.mktemp("there")
    trimesh.creation.box((0.25, 0.09, 0.1)).apply_translation((0, 0, 0.05)).export(root / "my_shoe.glb")
    (root / "my_shoe.yaml").write_text(mesh.write(assets.load("shoe"), "my_shoe.glb"))
    (root / "outputs/exchanges/openai+gpt-4o").mkdir(parents=True)
    release_assets.write(root / "RoboFactory" / "assets", "barrier")
    shutil.make_archive(str(root / "FILE"), "zip", packed(root / "FOLDER", released()))
    return root


@pytest.fixture
def in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Runs the test in that folder with an API key; removes third-party heads that its command registered."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setenv("OPENAI_API_KEY", "sk-none")
    known = {kind: dict(parts) for kind, parts in PARTS.items()}
    yield
    for kind, parts in PARTS.items():
        for name in parts.keys() - known[kind]:
            sys.modules.pop(parts.pop(name).part.__module__, None)


def test_every_shell_line_is_a_known_command() -> None:
    shell = [line for path in DOCUMENTS for line in fenced_lines(path.read_text("utf-8"), SHELL)]
    assert len(shell) > 40
    assert [line for line in shell if words(line) and line.strip() not in COMMANDS] == []


@pytest.mark.parametrize("line", [line for line in commands_of("python") if is_hydra(line)])
def test_hydra_composes_and_the_experiment_is_read(line: str, in_folder: None) -> None:
    register_all_tasks()
    _, _, module, *arguments = words(line)
    arguments = expand_release(arguments)
    overrides = [each for each in arguments if not each.startswith("-")]
    launchers = [each.partition("=")[2] for each in overrides if each.startswith("hydra/launcher=")]
    if any(find_spec(f"hydra_plugins.hydra_{name.split('_')[0]}_launcher") is None for name in launchers):
        overrides = [each for each in overrides if "hydra" not in each]
    parsed = OverridesParser.create().parse_overrides(overrides)
    jobs = BasicSweeper.split_arguments(parsed, None)[0] if "-m" in arguments else [overrides]
    for job in (jobs[0], jobs[-1])[: len(jobs)]:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            # In a command, Hydra itself sets the recipe.
            config = compose(HYDRA[module], ["recipe=test", *job])
        node: Any = OmegaConf.to_container(config, resolve=True)
        read_experiment(node)


class Parsed(BaseException):  # so that no handler of errors catches it
    """Ends the program once its arguments are parsed."""


def parser_commands() -> list[str]:
    clients = [line.replace(CLIENT, "python -m rf_exp.client", 1) for line in commands_of(CLIENT)]
    return [line for line in commands_of("python") if not is_hydra(line)] + clients


@pytest.mark.parametrize("line", parser_commands())
def test_a_parser_accepts_the_arguments(line: str, in_folder: None, monkeypatch: pytest.MonkeyPatch) -> None:
    parse_args = argparse.ArgumentParser.parse_args

    def stop(parser: argparse.ArgumentParser, *arguments: Any) -> None:
        parse_args(parser, *arguments)
        raise Parsed

    parts = words(line)
    module = parts[1] == "-m"
    target, arguments = (parts[2], parts[3:]) if module else (str(ROOT / parts[1]), parts[2:])
    if module and target not in ("tests.golden",) and not target.startswith("rf_exp"):
        assert find_spec(target) is not None
        return
    if not module and "argparse" not in Path(target).read_text("utf-8"):
        assert not arguments  # takes none; scripts that write documents run in the tests of those documents
        return
    if "ppo" in target and find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed; it is no part of the set-up")
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    monkeypatch.setattr(sys, "argv", [target, *(arguments or ["--help"])])
    if not module:
        monkeypatch.syspath_prepend(str(Path(target).parent))  # as Python does for a script
    with pytest.raises(Parsed if arguments else SystemExit) as ended:
        (runpy.run_module if module else runpy.run_path)(target, run_name="__main__")
    assert arguments or ended.value.code == 0  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("line", commands_of("make"))
def test_make_has_the_target(line: str) -> None:
    result = subprocess.run(["make", "-n", *words(line)[1:]], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("line", commands_of("pip"))
def test_extras_of_pip_commands_exist(line: str) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert {extra for listed in EXTRAS.findall(line) for extra in listed.split(",")} <= set(extras)


@pytest.mark.parametrize("line", [line for name in OTHERS for line in commands_of(name)])
def test_a_program_has_the_subcommand_and_the_options(line: str) -> None:
    arguments = words(line)[1:]
    subcommand = [
        each for each in arguments[:2] if re.fullmatch("[a-z-]+", each) and not each.startswith("-")
    ]
    command = [Path(sys.executable).with_name(program(line)), *subcommand, "--help"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    options = [each.partition("=")[0] for each in arguments if each.startswith("--")]
    assert [each for each in options if each not in result.stdout] == []
