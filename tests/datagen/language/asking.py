"""Requests to a model on the loopback interface, in the same way as runs."""

from dataclasses import replace

import yaml

from rf_exp.datagen import EpisodeGenerator, Settings
from rf_exp.datagen.brain import OpenAISpec, Question, read_brain, to_json
from rf_exp.statements import Proposal
from tests.conftest import CONF
from tests.datagen.guard import FULL
from tests.scenes import start_scene

KEY = "sk-test-0123456789abcdefghij"
GOOD = '{"Subgoals": {"Agent_1": "hold"}}'


def openai_spec(url, **changes) -> OpenAISpec:
    """`conf/brain/openai.yaml` with the test server and without retries."""
    node = yaml.safe_load((CONF / "brain" / "openai.yaml").read_text())
    node |= {"base_url": url, "api_key_env": "TEST_KEY", "exchanges": None, "retries": 0}
    spec = read_brain(node | changes)
    assert isinstance(spec, OpenAISpec)
    return spec


def scripted_answers(task):
    """Answers that lift the barrier: grasp, lift, and the empty proposal of a finished task."""
    scene = start_scene(task, 0)
    held = replace(scene, held=("barrier", "barrier"))
    proposals = [task.module.plan(each, task) for each in (scene, held)]
    return [to_json(each) for each in (*proposals, Proposal((), ()))]


def ask(spec, task, **question):
    return spec.make(task, FULL, 0).answer(Question(task, start_scene(task, 0), {}, **question))


def make(world, spec, attempts=4):
    settings = Settings.configured(world.task, FULL, spec, attempts=attempts)
    return EpisodeGenerator(settings, world, settings.make_brain(0)).make(0)
