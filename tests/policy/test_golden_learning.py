"""Trained weights and the commands of policies change only together with the version of the learner."""

import json
from typing import Any

import numpy as np
import pytest

from rf_exp.policy import LEARNER
from tests.policy import golden

RECORDED: dict[str, Any] = json.loads(golden.FILE.read_text())


@pytest.fixture(scope="session")
def current() -> dict[str, Any]:
    return golden.current_digests()


def test_the_file_is_of_this_learner_and_these_recipes() -> None:
    assert RECORDED["learner"] == LEARNER, "take the digests anew: python -m tests.policy.golden"
    assert list(RECORDED["recipes"]) == list(golden.RECIPES)


@pytest.mark.slow
@pytest.mark.parametrize("recipe", golden.RECIPES)
def test_weights_and_commands_are_as_recorded(current: dict[str, Any], recipe: str) -> None:
    now, before = current["recipes"][recipe], RECORDED["recipes"][recipe]
    np.testing.assert_allclose(now["losses"], before["losses"], rtol=1e-3)
    if now != before and current["processor"] != RECORDED["processor"]:
        pytest.skip(f"losses are as recorded; bytes are those of {RECORDED['processor']}")
    assert now == before, (
        "learning changed: raise LEARNER in rf_exp/policy/config.py, then python -m tests.policy.golden"
    )
