"""The constraint language: frozen statements, their sentences, and the verbs of subgoals.

Plans, planners and checks take statements. Sentences are for models and people: `Statement.sentence` writes
one, `read` reads one.
"""

from rf_exp.statements.base import Form, OfAgent, OfAgents, Proposal, Statement, kinds
from rf_exp.statements.events import Event, LiesOn, Step
from rf_exp.statements.limits import KeepApart, KeepHeight, KeepLevel, SpeedLimit
from rf_exp.statements.logical import WORK, ContactAt, Direction, PlaceAt, SameHeight, grasping
from rf_exp.statements.notation import TOGETHER_S, Vector, Words
from rf_exp.statements.reading import MAX_LENGTH, Unread, read, samples, understood
from rf_exp.statements.spatial import AvoidAgents, AvoidObjects, KeepOut, keep_clear
from rf_exp.statements.subgoals import read_subgoal, subgoal_forms
from rf_exp.statements.temporal import Before, Deadline, ShareSpace, Together
from rf_exp.statements.verbs import CONTACT_KINDS, VERBS, Narrow, Verb, add_verb
from rf_exp.statements.vocabulary import TABLE, Vocabulary, agent_name

__all__ = [
    "CONTACT_KINDS",
    "MAX_LENGTH",
    "TABLE",
    "TOGETHER_S",
    "VERBS",
    "WORK",
    "AvoidAgents",
    "AvoidObjects",
    "Before",
    "ContactAt",
    "Deadline",
    "Direction",
    "Event",
    "Form",
    "KeepApart",
    "KeepHeight",
    "KeepLevel",
    "KeepOut",
    "LiesOn",
    "Narrow",
    "OfAgent",
    "OfAgents",
    "PlaceAt",
    "Proposal",
    "SameHeight",
    "ShareSpace",
    "SpeedLimit",
    "Statement",
    "Step",
    "Together",
    "Unread",
    "Vector",
    "Verb",
    "Vocabulary",
    "Words",
    "add_verb",
    "agent_name",
    "grasping",
    "keep_clear",
    "kinds",
    "read",
    "read_subgoal",
    "samples",
    "subgoal_forms",
    "understood",
]
