"""RoboBrain: proposes subgoals and textual constraints."""

from rf_exp.datagen.brain.protocol import BadAnswer, Brain, Question, from_json, to_json
from rf_exp.datagen.brain.scripted import ScriptedBrain
from rf_exp.errors import choices

BRAINS = {ScriptedBrain.name: ScriptedBrain}

__all__ = ["BadAnswer", "Brain", "Question", "ScriptedBrain", "from_json", "make_brain", "to_json"]


def make_brain(name: str) -> Brain:
    """The brain of that name. Raises ArgumentError for a name that does not exist."""
    if name not in BRAINS:
        raise choices("brain", name, BRAINS)
    return BRAINS[name]()
