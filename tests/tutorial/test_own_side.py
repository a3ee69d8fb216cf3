"""A kind of constraint is added without an edit of the package, and so is a word for a verb."""

import re
import subprocess
import sys
from textwrap import dedent

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.statements import VERBS, Verb, add_verb
from tests.conftest import CONF

ROOT = CONF.parent


def run(code: str) -> str:
    """In a process of its own: what is added stays known in one."""
    done = subprocess.run(
        [sys.executable, "-c", dedent(code)], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_new_kind_is_read_checked_and_shown_to_models():
    told = run(
        """
        from dataclasses import replace
        import numpy as np
        from tests.tutorial.own_side import OwnSide
        from rf_exp.constraints import RoboChecker
        from rf_exp.coordination import serial
        from rf_exp.constraints.stl import Execution, judged, kept
        from rf_exp.datagen.brain.questions import constraint_forms
        from rf_exp.statements import Proposal, read
        from rf_exp.types import Row
        from tests.constraints.robots import REST, idle, real, scene_of, walk

        task = real("lift_barrier")
        said = read("Agent_1 must stay on its side of the table", task.vocabulary)
        assert said == OwnSide(1) and read(said.sentence, task.vocabulary) == said
        assert OwnSide.samples[0].sentence in constraint_forms()
        checker = RoboChecker(task, Proposal((), (said,)), Row("full"))
        scene = scene_of(task)
        across = np.array([0.0, 1.1, 0.0, -0.8, 0.0, 1.9, 0.785])  # stretched out over the middle
        trajectories = walk(1, [REST, across], 20), idle(2)
        checked = checker.check(checker.paths(trajectories, scene), serial(trajectories, Proposal((), ())))
        (violation,) = (each for each in checked.violations if each.cause == "space" and each.agents == (1,))
        print(violation.sentence)
        qpos = scene.qpos.copy()
        qpos[0, :7] = across
        assert checked.monitor()(scene) is None
        now = checked.monitor()(replace(scene, qpos=qpos))
        assert now.measured and not violation.measured and now.value == violation.value
        (check,) = (each for each in checker.checks if repr(each).startswith("NearOwnBase"))
        for seen in (scene, replace(scene, qpos=qpos)):
            execution = Execution(checked.plan, [seen])
            (found,) = judged(execution, check)
            assert found.holds == kept(execution, check) == (seen is scene)
        """
    )
    assert re.fullmatch(r"at [\d.]+ s 'Agent_1 must stay on its own side.': -0\.\d+ m \(bound 0 m\)\n", told)


def test_a_new_verb_has_its_form_and_its_words():
    told = run(
        """
        from rf_exp.statements import Before, Step, Verb, add_verb, read, read_subgoal, subgoal_forms
        from tests.constraints.robots import real

        add_verb(Verb("wipe", ("object",), words=("wipe wipes wiped wiped wiping",)))
        food = real("place_food").vocabulary
        assert read_subgoal(1, "wipe lid", food).verb == "wipe" and "wipe OBJECT" in subgoal_forms()
        said = read("Agent_1 must not lift the steak before the lid has been wiped by Agent_2", food)
        assert said == Before(Step(2, "wipe", "lid"), Step(1, "lift", "steak"))
        print(said.sentence)
        """
    )
    assert told == "Agent_2 must wipe lid before Agent_1 may lift steak.\n"


def test_a_verb_whose_words_mean_another_one_is_refused():
    with pytest.raises(ArgumentError, match="'grab' is a word for 'grasp' already"):
        add_verb(
            Verb("snatch", words=("snatch snatches snatched snatched snatching", "grab grabs - - grabbing"))
        )
    with pytest.raises(ArgumentError, match="has 2 forms; expected base, third person, past"):
        Verb("snatch", words=("snatch snatches",))
    assert "snatch" not in VERBS


@pytest.mark.parametrize("name", sorted(VERBS))
def test_every_verb_has_words_of_its_own(name):
    verb = VERBS[name]
    assert verb.form.split()[0] == name
    if verb.words:
        assert name in verb.finite and verb.third_person != verb.gerund
