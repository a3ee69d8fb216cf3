"""What all tests share: the repository's configuration and the tasks in it."""

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

hypothesis.settings.register_profile("suite", deadline=None)  # a busy machine is no failure
hypothesis.settings.load_profile("suite")

CONF = Path(__file__).parents[1] / "conf"
TASKS = tuple(sorted(path.stem for path in (CONF / "task").glob("*.yaml") if path.stem != "all"))

# The modules that take longest. Begun last, one process would be busy with them while the others wait.
LONG = (
    *("test_run", "test_kills", "test_generation", "test_environments", "test_depth_cameras", "test_golden"),
    *("test_checkers", "test_train", "test_launch", "test_benchmarks", "test_collisions", "test_logs"),
    *("test_shards", "test_correction", "test_start_up", "test_laws", "test_coordinator"),
    "test_varied_scenes",
)

RECIPES = {  # how each is chosen, by its name
    path.stem: path.relative_to(CONF / "policy").with_suffix("").as_posix()
    for path in sorted((CONF / "policy").rglob("*.yaml"))
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest modules first; `--no-loadscope-reorder` keeps to that."""
    places = {name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))


def read_task(name: str) -> Task:
    """The task as its YAML file says, without any experiment around it."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / f"{name}.yaml"))
    return load_task(name, node[name])


def experiment(*overrides: str) -> Experiment:
    """What a command with these overrides runs; its recipe, which Hydra names, is `test`."""
    return read_experiment(deepcopy(_composed(overrides)))


@cache
def _composed(overrides: tuple[str, ...]) -> Any:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_container(compose("config", ["recipe=test", *overrides]), resolve=True)


def cell_of(one: Experiment) -> "Cell":
    """The only cell of an experiment of one task and one row, for the policies of its first architecture."""
    from rf_exp.stages import cells  # imports torch, which most tests do without

    (cell,) = cells(one)
    return cell.with_arch(one.archs[0])


@pytest.fixture(params=TASKS)
def task(request: pytest.FixtureRequest) -> Task:
    """Every task in turn: a test that takes it is a law of the suite."""
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
        told = capsys.readouterr()
        return code, told.out, told.err

    return call


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., subprocess.CompletedProcess]:
    """`python -m rf_exp.run` in this process: exit code, standard output, standard error."""
    from rf_exp.run import main  # imports torch, which most tests do without

    def call(*arguments: str) -> subprocess.CompletedProcess:
        monkeypatch.setattr(sys, "argv", ["rf_exp.run", *arguments])
        GlobalHydra.instance().clear()
        capsys.readouterr()
        code = run_guarded(main)
        return subprocess.CompletedProcess(arguments, code, *capsys.readouterr())

    return call
