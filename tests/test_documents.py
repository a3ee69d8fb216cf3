"""Every command in README.md, CONTRIBUTING.md and docs/*.md is one that its program understands.

None is carried out to its end here: some take days, a GPU or a cluster. What each is put through, for real:

- `python -m rf_exp.run`, `.gallery`, `.demonstration`: Hydra composes the overrides, with `-m` for the
  first and the last job of the sweep, and the experiment is read and checked as the command would. Launchers
  that are not installed (Slurm, Ray) are left out of it.
- other modules, benchmarks, examples: run up to where their own parser has understood the arguments; with
  none, to their help.
- `make`: a dry run. `pip`: the extra exists. `rerun`, `dask`, `ray`: the subcommand and the options are in
  its help.
- `export`, `ssh` and `eval` are not looked into.

Beside that, elsewhere: the examples and the tutorial run in short (tests/envs, tests/library,
tests/tutorial), what writes documents is run and compared (tests/tasks, tests/ablation), and quick runs of
the main command, of rf_exp.data, the gallery and the demonstration are in their own tests.
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
CLIENT = "rf_exp-client"  # of its own distribution, and a command of the suite
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


def blocks(text: str, languages: tuple[str, ...]) -> list[str]:
    """The lines of fenced code in these languages; continued ones as one."""
    code = "\n".join(block for language, block in FENCED.findall(text) if language in languages)
    return list[str](code.replace("\\\n", " ").splitlines())


def lines(text: str) -> list[str]:
    """The lines of code in a document that may be a shell's, and what stands between backticks."""
    return [*blocks(text, (*SHELL, "")), *INLINE.findall(FENCED.sub("", text))]


def words(line: str) -> list[str]:
    """A line of a shell as a program and its arguments; without variables before, and what comes behind."""
    try:
        found = shlex.split(line.replace("$PWD", str(ROOT)), comments=True)
    except ValueError:  # it is no line of a shell
        return []
    while found and re.fullmatch(r"[A-Z_]+=.*", found[0]):
        found.pop(0)
    return found[: found.index(">")] if ">" in found else found


def program(line: str) -> str:
    """Without the folder it lies in; empty for what is no command."""
    said = words(line)
    return said[0].split("/")[-1] if len(said) > 1 or said == ["make"] else ""


def commands() -> list[str]:
    """All commands of all documents, once each, as they are written."""
    found = dict.fromkeys(line.strip() for path in DOCUMENTS for line in lines(path.read_text("utf-8")))
    return [line for line in found if program(line) in PROGRAMS]


COMMANDS = commands()


def of(name: str) -> list[str]:
    return [line for line in COMMANDS if program(line) == name]


def is_hydra(line: str) -> bool:
    said = words(line)
    return said[1] == "-m" and said[2] in HYDRA


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the documents speak of as there already: an annotated mesh, recorded answers, releases."""
    made = tmp_path_factory.mktemp("there")
    trimesh.creation.box((0.25, 0.09, 0.1)).apply_translation((0, 0, 0.05)).export(made / "my_shoe.glb")
    (made / "my_shoe.yaml").write_text(mesh.write(assets.load("shoe"), "my_shoe.glb"))
    (made / "outputs/exchanges/openai+gpt-4o").mkdir(parents=True)
    release_assets.write(made / "RoboFactory" / "assets", "barrier")
    shutil.make_archive(str(made / "FILE"), "zip", packed(made / "FOLDER", released()))
    return made


@pytest.fixture
def somewhere(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In that folder, with a key for a server. Heads of others that a command names are forgotten again."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setenv("OPENAI_API_KEY", "sk-none")
    known = {kind: dict(parts) for kind, parts in PARTS.items()}
    yield
    for kind, parts in PARTS.items():
        for name in parts.keys() - known[kind]:
            sys.modules.pop(parts.pop(name).part.__module__, None)


def test_no_line_of_a_shell_is_left_out() -> None:
    shell = [line for path in DOCUMENTS for line in blocks(path.read_text("utf-8"), SHELL)]
    assert len(shell) > 40
    assert [line for line in shell if words(line) and line.strip() not in COMMANDS] == []


@pytest.mark.parametrize("line", [line for line in of("python") if is_hydra(line)])
def test_hydra_composes_and_the_experiment_is_read(line: str, somewhere: None) -> None:
    register_all_tasks()
    _, _, module, *said = words(line)
    said = expand_release(said)
    overrides = [each for each in said if not each.startswith("-")]
    launchers = [each.partition("=")[2] for each in overrides if each.startswith("hydra/launcher=")]
    if any(find_spec(f"hydra_plugins.hydra_{name.split('_')[0]}_launcher") is None for name in launchers):
        overrides = [each for each in overrides if "hydra" not in each]
    parsed = OverridesParser.create().parse_overrides(overrides)
    jobs = BasicSweeper.split_arguments(parsed, None)[0] if "-m" in said else [overrides]
    for job in (jobs[0], jobs[-1])[: len(jobs)]:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            # Which recipe it is Hydra alone knows, of a command.
            config = compose(HYDRA[module], ["recipe=test", *job])
        node: Any = OmegaConf.to_container(config, resolve=True)
        read_experiment(node)


class Parsed(BaseException):  # so that nobody on the way explains it
    """The arguments are understood; nothing more is wanted."""


def modules() -> list[str]:
    clients = [line.replace(CLIENT, "python -m rf_exp.client", 1) for line in of(CLIENT)]
    return [line for line in of("python") if not is_hydra(line)] + clients


@pytest.mark.parametrize("line", modules())
def test_a_parser_understands_the_arguments(
    line: str, somewhere: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    understand = argparse.ArgumentParser.parse_args

    def stop(parser: argparse.ArgumentParser, *arguments: Any) -> None:
        understand(parser, *arguments)
        raise Parsed

    said = words(line)
    module = said[1] == "-m"
    target, arguments = (said[2], said[3:]) if module else (str(ROOT / said[1]), said[2:])
    if module and target not in ("tests.golden",) and not target.startswith("rf_exp"):
        assert find_spec(target) is not None
        return
    if not module and "argparse" not in Path(target).read_text("utf-8"):
        assert not arguments  # it takes none; what writes documents is run by the tests that compare them
        return
    if "ppo" in target and find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed; it is no part of the set-up")
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    monkeypatch.setattr(sys, "argv", [target, *(arguments or ["--help"])])
    if not module:
        monkeypatch.syspath_prepend(str(Path(target).parent))  # as where a script is run
    with pytest.raises(Parsed if arguments else SystemExit) as ended:
        (runpy.run_module if module else runpy.run_path)(target, run_name="__main__")
    assert arguments or ended.value.code == 0  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("line", of("make"))
def test_make_has_the_target(line: str) -> None:
    done = subprocess.run(["make", "-n", *words(line)[1:]], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", of("pip"))
def test_pip_is_asked_for_extras_that_there_are(line: str) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert {extra for found in EXTRAS.findall(line) for extra in found.split(",")} <= set(extras)


@pytest.mark.parametrize("line", [line for name in OTHERS for line in of(name)])
def test_a_program_has_the_subcommand_and_the_options(line: str) -> None:
    said = words(line)[1:]
    subcommand = [each for each in said[:2] if re.fullmatch("[a-z-]+", each) and not each.startswith("-")]
    command = [Path(sys.executable).with_name(program(line)), *subcommand, "--help"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    options = [each.partition("=")[0] for each in said if each.startswith("--")]
    assert [each for each in options if each not in done.stdout] == []
