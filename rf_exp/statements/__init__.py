"""The constraint language: frozen statements, their sentences, and the verbs of subgoals.

Each kind of statement has a file; `language` has the grammar of sentences. Plans, planners and checks take
statements. Sentences are for language models and people: `Statement.sentence` writes one, `read` parses one.
"""

from rf_exp.statements.language.base import (
    TABLE,
    TOGETHER_S,
    Event,
    LiesOn,
    MultiAgentStatement,
    OneAgentStatement,
    Proposal,
    Statement,
    Step,
    Vocabulary,
    Words,
    agent_name,
    kinds,
)
from rf_exp.statements.language.reading import (
    MAX_LENGTH,
    UnparsedStatement,
    read,
    read_or_unparsed,
    read_subgoal,
    samples,
    subgoal_forms,
)
from rf_exp.statements.language.verbs import VERBS, AmbiguousSynonym, Verb, add_verb

# Kinds are shown in prompts, and tried on sentences, in the order of their definition.
# isort: off
from rf_exp.statements.keep_apart import KeepApart
from rf_exp.statements.keep_level import KeepLevel
from rf_exp.statements.keep_height import KeepHeight
from rf_exp.statements.speed_limit import SpeedLimit
from rf_exp.statements.interaction import ContactAt, PlaceAt
from rf_exp.statements.direction import Direction, grasping
from rf_exp.statements.same_height import SameHeight
from rf_exp.statements.avoidance import AvoidAgents, AvoidObjects, keep_clear
from rf_exp.statements.keep_out import KeepOut
from rf_exp.statements.before import Before
from rf_exp.statements.deadline import Deadline
from rf_exp.statements.together import Together
from rf_exp.statements.share_space import ShareSpace
# isort: on

__all__ = [
    "MAX_LENGTH",
    "TABLE",
    "TOGETHER_S",
    "VERBS",
    "AmbiguousSynonym",
    "AvoidAgents",
    "AvoidObjects",
    "Before",
    "ContactAt",
    "Deadline",
    "Direction",
    "Event",
    "KeepApart",
    "KeepHeight",
    "KeepLevel",
    "KeepOut",
    "LiesOn",
    "MultiAgentStatement",
    "OneAgentStatement",
    "PlaceAt",
    "Proposal",
    "SameHeight",
    "ShareSpace",
    "SpeedLimit",
    "Statement",
    "Step",
    "Together",
    "UnparsedStatement",
    "Verb",
    "Vocabulary",
    "Words",
    "add_verb",
    "agent_name",
    "grasping",
    "keep_clear",
    "kinds",
    "read",
    "read_or_unparsed",
    "read_subgoal",
    "samples",
    "subgoal_forms",
]
