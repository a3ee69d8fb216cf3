"""Properties of all findings: each has a sentence with its facts, and can be stored and restored."""

import re
from dataclasses import replace

import pytest

from rf_exp.artifacts import plain, restored
from rf_exp.findings import Account, Cause, CheckName, Doing, Finding, Violation

ALL_FIELDS = Violation(
    check=CheckName.OCCUPANCY,
    cause=Cause.SPACE,
    value=0.25,
    bound=0.5,
    unit="m",
    time_s=2.5,
    agents=(1, 2),
    obstacles=("pot",),
    object="steak",
    aspect="left",
    doing=(Doing("lift steak", "lift", 1.5), None),
    parts=("panda_hand", "panda_link5"),
    subgoals=("lift steak", "place steak to pot"),
    known=("inside",),
    refusal="the answer is empty",
    constraint="Agent_1 must keep clear.",
)


@pytest.mark.parametrize("finding", Finding)
def test_every_finding_fills_its_template(finding: Finding) -> None:
    violation = replace(ALL_FIELDS, finding=finding)
    sentence = violation.sentence
    assert sentence and not set("{}") & set(sentence)
    assert re.findall(r"\{(\w+)", finding.template) or sentence == finding.template
    assert replace(violation, measured=True).sentence  # also for measured violations, which have no plan
    assert "0.25" not in violation.kind and "2.5" not in violation.kind


@pytest.mark.parametrize("finding", Finding)
def test_a_violation_can_be_stored_and_restored(finding: Finding) -> None:
    account = Account(rejections=(replace(ALL_FIELDS, finding=finding, measured=True),))
    assert restored(Account, plain(account)) == account


def test_findings_have_unique_codes() -> None:
    assert len({str(finding) for finding in Finding}) == len(Finding.__members__)


def test_the_moving_agent_is_blocked_by_the_resting_one() -> None:
    parked = replace(ALL_FIELDS, finding=Finding.PARKED)
    assert parked.sentence.startswith(
        "where Agent_2 stands before and after its motion blocks Agent_1 1.50 s"
    )
    other = replace(parked, doing=parked.doing[::-1])
    assert other.sentence.startswith("where Agent_1 stands before and after its motion blocks Agent_2 1.50 s")
