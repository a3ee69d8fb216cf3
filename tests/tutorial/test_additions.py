"""Constraints, verbs and sets of constraints can be added without editing the package."""

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
    """The output of code in a process of its own, because registrations last as long as their process."""
    done = subprocess.run(
        [sys.executable, "-c", dedent(code)], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_new_constraint_is_parsed_checked_and_shown_to_models():
    output = run(
        """
        from dataclasses import replace
        import numpy as np
        from tests.tutorial.own_side import OwnSide
        from rf_exp.constraints import RoboChecker
        from rf_exp.coordination import sequential
        from rf_exp.constraints.stl import Execution, evaluate_check, monitor_verdict
        from rf_exp.datagen.brain.language import constraint_forms
        from rf_exp.statements import Proposal, read
        from rf_exp.types import ConstraintSet
        from tests.constraints.robots import REST, idle, real, scene_of, walk

        task = real("lift_barrier")
        said = read("Agent_1 must stay on its side of the table", task.vocabulary)
        assert said == OwnSide(1) and read(said.sentence, task.vocabulary) == said
        assert OwnSide.samples[0].sentence in constraint_forms()
        checker = RoboChecker(task, Proposal((), (said,)), ConstraintSet("full"))
        scene = scene_of(task)
        across = np.array([0.0, 1.1, 0.0, -0.8, 0.0, 1.9, 0.785])  # stretched out over the middle
        trajectories = walk(1, [REST, across], 20), idle(2)
        checked = checker.check(
            checker.paths(trajectories, scene), sequential(trajectories, Proposal((), ()))
        )
        (violation,) = (each for each in checked.violations if each.cause == "space" and each.agents == (1,))
        print(violation.sentence)
        qpos = scene.qpos.copy()
        qpos[0, :7] = across
        assert checked.monitor()(scene) is None
        now = checked.monitor()(replace(scene, qpos=qpos))
        assert now.measured and not violation.measured and now.value == violation.value
        (check,) = (each for each in checker.checks if repr(each).startswith("OwnSideCheck"))
        for seen in (scene, replace(scene, qpos=qpos)):
            execution = Execution(checked.plan, [seen])
            (found,) = evaluate_check(execution, check)
            assert found.holds == monitor_verdict(execution, check) == (seen is scene)
        """
    )
    assert re.fullmatch(
        r"at [\d.]+ s 'Agent_1 must stay on its own side.': -0\.\d+ m \(bound 0 m\)\n", output
    )


@pytest.mark.slow
def test_a_new_verb_has_its_form_and_its_words():
    output = run(
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
    assert output == "Agent_2 must wipe lid before Agent_1 may lift steak.\n"


@pytest.mark.slow
def test_a_new_verb_is_planned_checked_and_scheduled_with_the_others():
    output = run(
        """
        import numpy as np
        from tests.tutorial.hover import OVER_M
        from rf_exp.datagen import Planned, Planner, Settings
        from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
        from rf_exp.statements import Before, Proposal, Step, keep_clear
        from rf_exp.types import ConstraintSet, Subgoal
        from tests.constraints.robots import real
        from tests.scenes import start_scene

        class Brain:
            name = "own"
            def answer(self, question):
                goals = Subgoal(1, "grasp", "steak", "center"), Subgoal(2, "hover", "pot")
                order = Before(Step(2, "hover", "pot"), Step(1, "grasp", "steak"))
                return to_json(Proposal(goals, (order, *keep_clear(question.task.agents))))

        task = real("place_food")
        scene = start_scene(task, 0)
        settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
        plan = Planner(settings, Brain()).plan(Question(task, scene, {}), scene, np.random.default_rng(0))
        assert isinstance(plan, Planned), plan
        grasp, hover = plan.trajectories
        assert [segment.primitive for segment in hover.segments] == ["hover"]
        tcp = plan.checked.plan.planning_scene.arms[1].tcp(hover.segments[-1].qpos[-1])
        assert np.allclose(tcp[:3, 3], scene.poses["pot"][:3, 3] + [0, 0, OVER_M], atol=1e-3)
        first, then = (plan.schedule.positions[:, k] for k in (1, 0))
        assert (then[first < len(hover)] == 0).all() and then[-1] == len(grasp)
        print(plan.proposal.constraints[0].sentence)
        """
    )
    assert output == "Agent_2 must hover pot before Agent_1 may grasp steak.\n"


@pytest.mark.slow
def test_a_verb_without_a_motion_primitive_is_refused():
    run(
        """
        import pytest
        from rf_exp.datagen import add_primitive
        from rf_exp.errors import ArgumentError

        with pytest.raises(ArgumentError, match="verb 'dance'; available: .*grasp"):
            add_primitive("dance", lambda *_: [])
        with pytest.raises(ArgumentError, match="'lift' has a motion primitive already"):
            add_primitive("lift", lambda *_: [])
        """
    )


@pytest.mark.slow
def test_a_new_set_of_constraints_is_a_file():
    output = run(
        """
        from hydra import compose, initialize_config_dir
        from omegaconf import OmegaConf
        from rf_exp.command import register_all_tasks
        from rf_exp.constraints import RoboChecker
        from rf_exp.experiment import read_experiment
        from tests.conftest import CONF
        from tests.scenes import start_scene

        register_all_tasks()
        folder = f"hydra.searchpath=[file://{CONF.parent}/tests/tutorial/conf]"
        with initialize_config_dir(str(CONF), version_base="1.3"):
            node = compose("config", ["recipe=test", folder, "constraints=spatial_temporal"])
            node = OmegaConf.to_container(node, resolve=True)
        experiment = read_experiment(node)
        (task,), (own,) = experiment.tasks, experiment.constraint_sets
        assert experiment.settings(task, own).constraint_set == own
        proposal = task.module.plan(start_scene(task, 0), task)
        checker = RoboChecker(task, proposal, own)
        assert {check.kind for check in checker.code.checks} == {"logical", "spatial", "temporal"}
        print(own.name, *sorted({check.kind for check in checker.checks}))
        """
    )
    assert output == "spatial_temporal spatial temporal\n"


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
        assert name in verb.finite_forms and verb.third_person != verb.gerund
