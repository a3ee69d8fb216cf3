"""Helpers and fixtures for all tests: the repository's configuration and its tasks."""

import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from rf_exp.command import register_all_tasks, run_guarded
from rf_exp.experiment import Experiment, read_experiment
from rf_exp.tasks import Task, load_task

if TYPE_CHECKING:
    from rf_exp.stages import Cell

hypothesis.settings.register_profile("suite", deadline=None)  # no failures on a busy machine
hypothesis.settings.load_profile("suite")

CONF = Path(__file__).parents[1] / "conf"
TASKS = tuple(sorted(path.stem for path in (CONF / "task").glob("*.yaml") if path.stem != "all"))

# The slowest modules. Started last, they would keep one process busy while the others wait.
LONG = (
    *("test_run", "test_kills", "test_generation", "test_environments", "test_depth_cameras", "test_golden"),
    *("test_checkers", "test_train", "test_launch", "test_benchmarks", "test_collisions", "test_logs"),
    *("test_shards", "test_correction", "test_start_up", "test_laws", "test_coordinator"),
    "test_varied_scenes",
)

RECIPES = {  # name of a recipe -> its choice as in policy=CHOICE
    path.stem: path.relative_to(CONF / "policy").with_suffix("").as_posix()
    for path in sorted((CONF / "policy").rglob("*.yaml"))
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sorts the slowest modules first; `--no-loadscope-reorder` keeps this order."""
    ranks = {name: rank for rank, name in enumerate(LONG)}
    items.sort(key=lambda item: ranks.get(item.path.stem, len(ranks)))


def read_task(name: str) -> Task:
    """The task of a YAML file, without an experiment."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / f"{name}.yaml"))
    return load_task(name, node[name])


def experiment(*overrides: str) -> Experiment:
    """The experiment of a command with these overrides; the recipe, which Hydra would name, is `test`."""
    return read_experiment(deepcopy(_composed(overrides)))


@cache
def _composed(overrides: tuple[str, ...]) -> Any:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_container(compose("config", ["recipe=test", *overrides]), resolve=True)


def cell_of(configured: Experiment) -> "Cell":
    """The only cell of an experiment with one task and one row, with its first architecture."""
    from rf_exp.stages import cells  # imports torch, which most tests do not need

    (cell,) = cells(configured)
    return cell.with_arch(configured.archs[0])


@pytest.fixture(params=TASKS)
def task(request: pytest.FixtureRequest) -> Task:
    """Every task in turn: tests with this fixture hold for the whole suite."""
    return read_task(request.param)


@pytest.fixture
def lift_barrier() -> Task:
    return read_task("lift_barrier")


@pytest.fixture
def place_food() -> Task:
    return read_task("place_food")


@pytest.fixture
def data_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """`python -m rf_exp.data` in this process: exit code, standard output, standard error."""
    from rf_exp.data.__main__ import main

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp.data", *map(str, arguments)])
        capsys.readouterr()
        code = run_guarded(main)
        output = capsys.readouterr()
        return code, output.out, output.err

    return call


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., subprocess.CompletedProcess]:
    """`python -m rf_exp.run` in this process: exit code, standard output, standard error."""
    from rf_exp.run import main  # imports torch, which most tests do not need

    def call(*arguments: str) -> subprocess.CompletedProcess:
        monkeypatch.setattr(sys, "argv", ["rf_exp.run", *arguments])
        GlobalHydra.instance().clear()
        capsys.readouterr()
        code = run_guarded(main)
        return subprocess.CompletedProcess(arguments, code, *capsys.readouterr())

    return call
