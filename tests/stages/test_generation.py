"""Generation: one row per seed, whenever it is killed, and the content of the rows."""

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import GenerationRow, append_row, read_rows
from rf_exp.datagen import EpisodeGenerator, NullObserver, Outcome, Settings, generator_version
from rf_exp.datagen.brain import Question, ScriptedBrain, ScriptedSpec
from rf_exp.findings import Account, Unmet, Violation
from rf_exp.sim import Simulator
from rf_exp.stages import why_seeds_failed
from rf_exp.stages.generation import generation_row
from rf_exp.store import Store
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet
from tests.conftest import cell_of, experiment, read_task

FULL = ConstraintSet("full")


class Answers(ScriptedBrain):
    """Brain that gives fixed answers first, then those of the script."""

    def __init__(self, *first: str) -> None:
        self.first = list(first)

    def answer(self, question: Question) -> str:
        return self.first.pop(0) if self.first else super().answer(question)


class Rejections(NullObserver):
    """Observer that counts rejections as they happen."""

    count = 0

    def rejected(self, violation: Violation) -> None:
        self.count += 1


@pytest.mark.slow
def test_a_row_counts_the_violations_of_its_attempt(lift_barrier: Task) -> None:
    """As counted in the loop: repaired, given up within the budget, and at its end."""
    bad, nothing = "no json", json.dumps({"Subgoals": {}})
    cases = [
        ((), True, 0),
        ((bad, bad), True, 2),
        ((nothing,), False, 0),
        ((bad, nothing), False, 1),
        ((bad, bad, nothing), False, 2),
        ((bad, bad, bad), False, 3),
    ]
    with Simulator(lift_barrier, render=False) as world:
        for answers, success, expected in cases:
            rejections = Rejections()
            settings = Settings.configured(lift_barrier, FULL, ScriptedSpec(), attempts=3)
            outcome = EpisodeGenerator(settings, world, Answers(*answers), rejections).make(0)
            row = generation_row(settings, outcome)
            assert (row.success, row.violations) == (success, expected) == (outcome.success, rejections.count)
            assert (row.contacts, row.generator) == (outcome.contacts, generator_version(lift_barrier))


ARGUMENTS = ("stages=[generate]", "task=pick_meat", "render=false", "workers=1")
ROWS, DATA = "results/generate/pick_meat/full-disturbed.jsonl", "data/pick_meat/full/fast.zarr"

# The command, in a process that is killed where `{where}` is called for the seed 1.
KILLED = """
import os, signal, sys
from rf_exp.command import run_guarded
from rf_exp.run import main
from rf_exp.stages import generation

before = {where}
def killed(*arguments):
    if str(getattr(arguments[-1], "seed", arguments[-1])).endswith("1"):  # a row, an episode, "scene 1"
        os.kill(os.getpid(), signal.SIGKILL)
    return before(*arguments)
{where} = killed
sys.exit(run_guarded(main))
"""


def run_and_kill(where: str, *arguments: str) -> None:
    code = KILLED.format(where=where)
    ran = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, timeout=300)
    assert ran.returncode == -signal.SIGKILL, ran.stderr


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds, generated without interruption."""
    out = tmp_path_factory.mktemp("whole")
    command = [sys.executable, "-m", "rf_exp.run", *ARGUMENTS, "recordings=0", "episodes=2", f"out={out}"]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return out


def untimed_rows(out: Path) -> list[GenerationRow]:
    return [replace(row, wall_s=0.0) for row in read_rows(out / ROWS, GenerationRow)]


@pytest.mark.slow
@pytest.mark.parametrize("goal", ["episodes=2", "demos=2"])
def test_a_kill_between_episode_and_row_loses_no_row(command, tmp_path, whole, goal) -> None:
    """The last seed is stored before its row is written; resuming must only write that row."""
    arguments = (*ARGUMENTS, "recordings=0", goal, f"out={tmp_path}")
    run_and_kill("generation.append_row", *arguments)
    assert Store.open(tmp_path / DATA).seeds.tolist() == [0, 1]
    assert [row.seed for row in untimed_rows(tmp_path)] == [0]
    for _ in range(2):
        assert command(*arguments).returncode == 0
        assert untimed_rows(tmp_path) == untimed_rows(whole)
    one, two = Store.open(tmp_path / DATA), Store.open(whole / DATA)
    assert one.digest() == two.digest() and one.certificates == two.certificates


@pytest.mark.slow
def test_a_kill_before_the_episode_is_stored_gives_the_same(command, tmp_path, whole) -> None:
    arguments = (*ARGUMENTS, "recordings=0", "episodes=2", f"out={tmp_path}")
    run_and_kill("generation.Store.append", *arguments)
    assert command(*arguments).returncode == 0
    assert untimed_rows(tmp_path) == untimed_rows(whole)
    assert Store.open(tmp_path / DATA).digest() == Store.open(whole / DATA).digest()


@pytest.mark.slow
def test_a_removed_line_comes_back_from_the_store(command, tmp_path) -> None:
    """As the message about a damaged line says."""
    arguments = (*ARGUMENTS, "recordings=0", "episodes=2", f"out={tmp_path}")
    assert command(*arguments).returncode == 0
    before, path = untimed_rows(tmp_path), tmp_path / ROWS
    first, second = path.read_text().splitlines(keepends=True)
    path.write_text(first.replace("pick_meat", "pick_neat") + second)
    result = command(*arguments)
    assert result.returncode == 1
    assert f"{path}, line 1" in result.stderr and "remove that line and run the same command" in result.stderr
    path.write_text(second)
    assert command(*arguments).returncode == 0
    assert sorted(untimed_rows(tmp_path), key=lambda row: row.seed) == before


@pytest.mark.slow
def test_partial_files_of_a_kill_are_removed(command, tmp_path) -> None:
    arguments = (*ARGUMENTS, "recordings=2", "episodes=2", f"out={tmp_path}")
    run_and_kill("generation.recording.EpisodeRecorder", *arguments)  # the second recording is under way
    assert len(list(tmp_path.rglob("*.partial"))) == 1
    assert command(*arguments[:-2], "recordings=1", *arguments[-2:]).returncode == 0
    assert not list(tmp_path.rglob("*.partial"))
    assert [path.name for path in (tmp_path / "recordings").rglob("*.*")] == ["generate-fast-0.rrd"]


@pytest.mark.slow
def test_rows_and_store_name_the_code_that_made_them(whole, pick_meat) -> None:
    attrs = Store.open(whole / DATA).attrs
    for row in untimed_rows(whole):
        assert (row.generator, row.commit) == (attrs["generator"], attrs["commit"])
    assert attrs["generator"] == generator_version(pick_meat)


@pytest.fixture
def pick_meat() -> Task:
    return read_task("pick_meat")


def test_the_commonest_reasons_are_shown_if_no_seed_succeeds(tmp_path: Path) -> None:
    configured = experiment("task=pick_meat", f"out={tmp_path}", "disturbance_rad=0", "delay_s=0")
    settings, path = cell_of(configured).settings, cell_of(configured).generation_path
    path.parent.mkdir(parents=True)
    kinds = ["lid off"] * 3 + ["at rest"] * 2 + ["upright", "up"]
    for seed, name in enumerate(kinds):
        failed = Outcome(seed, False, False, 9, 1, 0, 0.1, Account(unmet=(Unmet(name, 0.0),)))
        append_row(path, generation_row(settings, failed))
    assert why_seeds_failed(configured) == (
        f"3 of 7: lid off | 2 of 7: at rest | 1 of 7: upright | and 1 rarer; the rows are in {path}"
    )
