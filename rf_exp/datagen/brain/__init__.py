"""RoboBrain: proposes subgoals and textual constraints."""

from rf_exp.datagen.brain.chat.probing import probe
from rf_exp.datagen.brain.faults import FAULTS
from rf_exp.datagen.brain.faulty import FaultyBrain, FaultySpec, applies, faults_for
from rf_exp.datagen.brain.language import LanguageBrain, OpenAISpec, ReplaySpec
from rf_exp.datagen.brain.protocol import BadAnswer, Brain, Question, from_json, to_json
from rf_exp.datagen.brain.scripted import ScriptedBrain, ScriptedSpec
from rf_exp.datagen.brain.spec import SPECS, BrainSpec, read_brain

__all__ = [
    "FAULTS",
    "SPECS",
    "BadAnswer",
    "Brain",
    "BrainSpec",
    "FaultyBrain",
    "FaultySpec",
    "LanguageBrain",
    "OpenAISpec",
    "Question",
    "ReplaySpec",
    "ScriptedBrain",
    "ScriptedSpec",
    "applies",
    "faults_for",
    "from_json",
    "probe",
    "read_brain",
    "to_json",
]
