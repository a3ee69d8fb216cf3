"""What went wrong, as values: violations, and the account of an episode. Sentences are written from them."""

from rf_exp.findings.account import NOTHING, Account, Closest, Knock, Lost, Touch, Unmet, bound_text
from rf_exp.findings.dialogue import Answer, Dialogue, Ruling
from rf_exp.findings.finding import (
    About,
    Cause,
    CheckName,
    Doing,
    Finding,
    Found,
    Misread,
    Violation,
    agent_name,
    names,
)

__all__ = [
    "NOTHING",
    "About",
    "Account",
    "Answer",
    "Cause",
    "CheckName",
    "Closest",
    "Dialogue",
    "Doing",
    "Finding",
    "Found",
    "Knock",
    "Lost",
    "Misread",
    "Ruling",
    "Touch",
    "Unmet",
    "Violation",
    "agent_name",
    "bound_text",
    "names",
]
