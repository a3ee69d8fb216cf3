"""The page of a demonstration: phases, check code and verdicts of a real episode with one mistake."""

import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra

from rf_exp.command import run_guarded
from rf_exp.constraints import RoboChecker
from rf_exp.datagen import Planned, Settings
from rf_exp.datagen.brain import FaultySpec, ScriptedSpec
from rf_exp.demonstration import demonstrate
from rf_exp.demonstration.__main__ import main
from rf_exp.demonstration.episode_log import phases
from rf_exp.statements import Proposal
from rf_exp.types import NO_PICTURES, ConstraintSet, Schedule
from tests.conftest import read_task
from tests.scenes import start_scene
from tests.viz.recorded import TWO

FULL = ConstraintSet("full")
LIFT = read_task("lift_barrier")


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """The page of Lift Barrier, without pictures, by a brain that makes one mistake."""
    folder = tmp_path_factory.mktemp("demonstrations")
    settings = Settings.configured(LIFT, FULL, FaultySpec("wrong_direction"))
    outcome = demonstrate(settings, NO_PICTURES, 0, folder)
    assert outcome.success
    return folder / "lift_barrier-0.md"


@pytest.mark.slow
def test_a_mistake_and_its_repair_are_on_the_page(page):
    first, second, third = page.read_text().split("\n## ")[1:4]
    assert first.startswith("Round 1, at 0.00 s: rejected")
    assert "must be horizontal at barrier" in first  # the mistake in RoboBrain's words
    assert re.search(r"\nand VD\(Agent_\d, barrier, horizontal\)", first)
    assert "### Violation: `ValidateDirection`" in first
    assert re.search(r"the gripper of Agent_\d is 90 deg off the horizontal .*bound 10 deg, at", first)
    assert second.startswith("Round 2, at 0.00 s: executed")
    assert "told of the violated ValidateDirection" in second
    assert "horizontal" not in second
    assert third.startswith("Round 3, at 2.")


@pytest.mark.slow
def test_the_html_page_equals_the_markdown_page(page):
    shown = page.with_suffix(".html").read_text()
    assert "<title>Lift Barrier: one demonstration</title>" in shown
    for number, heading in enumerate(re.findall(r"\n## (.*)", page.read_text()), start=1):
        assert f'<a href="#part-{number}">{heading}</a>' in shown and f'<h2 id="part-{number}">' in shown
    assert shown.count("<table>") == len(re.findall(r"^\|(?: ?-+ ?\|)+$", page.read_text(), re.MULTILINE))
    assert set(re.findall(r'<img src="(.*?)"', shown)) == set(re.findall(r"\]\((.*?)\)", page.read_text()))
    assert "|---|" not in shown and "```" not in shown and "<script" not in shown


@pytest.mark.slow
def test_every_check_of_a_plan_is_in_exactly_one_phase(page):
    shown = page.read_text().split("\n## ")[2]
    phase_texts = shown.split("\n### ")[1:]
    for check in re.findall(r"\| (?:logical|temporal|spatial) \|.*\| `(.*)` \|", shown):
        planned = [part.split("As measured")[0] for part in phase_texts]
        assert sum(f"| holds | `{check}` |" in part for part in planned) == 1, check
        line = re.compile(rf"^(and )?{re.escape(check)}$", re.MULTILINE)
        assert sum(line.search(part) is not None for part in planned) == 1, check
    measured = shown.split("As measured when it happened:")[1]
    for agent, side in ((1, "left"), (2, "right")):  # also for the agent that arrives in the last step
        assert f"| holds | `VI(Agent_{agent}, barrier, {side})` |" in measured


@pytest.mark.slow
def test_formulas_and_their_robustness_are_on_the_page_and_in_json(page):
    record = json.loads(page.with_suffix(".json").read_text())
    assert len(record["stl"]) == 2 and record["certificate"]["evidence"]["lifted"]
    for plan in record["stl"]:
        steps = {len(signal["values"]) for signal in plan["signals"].values()}
        formulas = [each for check in plan["checks"] for each in check["formulas"]]
        assert len(steps) == 1 and formulas and all(each["holds"] for each in formulas)
        assert all(f"`{each['stl']}`" in page.read_text() for each in formulas)
        assert any((each["robustness"] or 0) > 0.01 for each in formulas)
    assert page.read_text().count("Robustness is how much is left of a formula's bound") == 1


@pytest.mark.slow
def test_disabled_constraints_are_marked_and_absent_from_the_check_code(tmp_path, page):
    logical = ConstraintSet("logical", spatial=False, temporal=False)
    settings = Settings.configured(LIFT, logical, ScriptedSpec())
    assert demonstrate(settings, NO_PICTURES, 0, tmp_path).success
    shown = (tmp_path / "lift_barrier-0.md").read_text()
    assert "`logical` switches temporal and spatial constraints off" in shown
    marked = dict.fromkeys(("logical", "temporal", "spatial"), 0)
    for kind, off, check in re.findall(r"\| (logical|temporal|spatial) \|.*\| (.*)`(.*)` \|", shown):
        assert bool(off) == (kind != "logical") and off in ("", "*switched off*: ")
        assert (f"| holds | `{check}` |" in shown) != bool(off)
        marked[kind] += 1
    assert all(marked.values())
    assert "switched off" not in page.read_text()  # all are on


@pytest.mark.slow
def test_pictures_and_recording_lie_beside_the_page(page):
    linked = re.findall(r"\]\((.*?)\)", page.read_text())
    assert {"lift_barrier-0/round-2-lanes.png", "lift_barrier-0/round-3-diagrams.png"} <= set(linked)
    assert {str(path.relative_to(page.parent)) for path in page.with_suffix("").iterdir()} == set(linked)
    assert page.with_suffix(".rrd").stat().st_size > 100_000
    assert not list(page.parent.glob(".*"))  # no temporary files are left


def test_subgoals_that_begin_together_are_one_phase():
    def phases_after(wait_steps: int) -> list[tuple[float, list[int]]]:
        """Agent 2 begins after `wait_steps`, agent 1 at once."""
        second = np.clip(np.arange(51) - wait_steps, 0, 20)
        schedule = Schedule(np.column_stack([np.minimum(np.arange(51), 30), second]), 30)
        checker = RoboChecker(LIFT, Proposal((), ()), ConstraintSet("logical"))
        checked = checker.check(checker.paths(TWO, start_scene(LIFT, 0)), schedule)
        plan = Planned(Proposal((), ()), checker, TWO, checked)
        return [(phase.begins_s, [goal.agent for goal in phase.goals]) for phase in phases(plan, 2.0)]

    assert phases_after(0) == phases_after(10) == [(2.0, [1, 2])]
    assert phases_after(11) == [(2.0, [1]), (pytest.approx(2.55), [2])]


def run_command(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["rf_exp.demonstration", *arguments])
    GlobalHydra.instance().clear()
    return run_guarded(main)


@pytest.mark.render
def test_one_command_makes_the_page_with_pictures_of_the_global_camera(monkeypatch, tmp_path):
    small = "picture={width: 64, height: 48}"
    assert run_command(monkeypatch, "task=lift_barrier", "seed=3", small, f"out={tmp_path}") == 0
    page = tmp_path / "demonstrations" / "lift_barrier-3.md"
    assert "| scene seed | 3 |" in page.read_text()
    names = ["phase-1.1.jpg", "phase-2.1.jpg", "end.jpg"]
    pictures = [np.asarray(cv2.imread(str(page.with_suffix("") / name))) for name in names]
    assert all(picture.shape == (48, 64, 3) for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[2])


def test_several_rows_of_constraints_are_refused(monkeypatch, capsys, tmp_path):
    assert run_command(monkeypatch, "constraints=all", "render=false", f"out={tmp_path}") == 2
    assert "a demonstration is of one row of constraints, got logical, " in capsys.readouterr().err
