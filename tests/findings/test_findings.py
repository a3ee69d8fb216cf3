"""Laws over all findings: each has a sentence, written from its facts, and survives being written down."""

import re
from dataclasses import replace

import pytest

from rf_exp.artifacts import plain, restored
from rf_exp.findings import Account, Cause, CheckName, Doing, Finding, Violation

EVERYTHING = Violation(
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
def test_every_finding_says_the_facts_that_its_form_names(finding: Finding) -> None:
    violation = replace(EVERYTHING, finding=finding)
    said = violation.sentence
    assert said and not set("{}") & set(said)
    assert re.findall(r"\{(\w+)", finding.template) or said == finding.template
    assert replace(violation, measured=True).sentence  # what is measured is known without a plan
    assert "0.25" not in violation.kind and "2.5" not in violation.kind


@pytest.mark.parametrize("finding", Finding)
def test_a_violation_survives_being_written_down(finding: Finding) -> None:
    account = Account(rejections=(replace(EVERYTHING, finding=finding, measured=True),))
    assert restored(Account, plain(account)) == account


def test_findings_have_codes_of_their_own() -> None:
    assert len({str(finding) for finding in Finding}) == len(Finding.__members__)


def test_who_is_on_its_way_is_blocked_by_who_stands() -> None:
    parked = replace(EVERYTHING, finding=Finding.PARKED)
    assert parked.sentence.startswith(
        "where Agent_2 stands before and after its motion blocks Agent_1 1.50 s"
    )
    other = replace(parked, doing=parked.doing[::-1])
    assert other.sentence.startswith("where Agent_1 stands before and after its motion blocks Agent_2 1.50 s")
