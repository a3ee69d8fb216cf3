import pytest

from rf_exp.statements import read
from tests.statements.sentences import FOOD


@pytest.fixture(scope="session", autouse=True)
def compiled_patterns() -> None:
    """Compiles the patterns by reading one sentence, before any reading is timed."""
    read("Agent_1 and Agent_2 may share the same space in turn.", FOOD.vocabulary)
