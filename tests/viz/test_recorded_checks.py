"""Proposals, checks, violations and conditions in a recording."""

import numpy as np

from rf_exp.findings import Account, Cause, CheckName, Closest, Finding, Unmet, Violation
from rf_exp.statements import Proposal, Together
from rf_exp.texts.markdown import Markdown
from rf_exp.types import Measured, Rollout, Subgoal, Verdict
from rf_exp.viz import VIOLATED, text
from rf_exp.viz.layout import PRIMITIVES, WAITS
from tests.viz.recorded import BLOCKED, POSES, QPOS, RESULTS, Content, open_recorder


def test_verdicts_and_violations_have_reasons(path):
    with open_recorder(path) as recorder:
        recorder.violation(CONTACT, [(0.0, 0.1, 0.3), (0.0, -0.1, 0.3)])
        recorder.violation(CONTACT, [(0.0, 0.2, 0.3)])
        recorder.violation(BLOCKED)
        recorder.step(3, poses=POSES, qpos=QPOS)
        recorder.verdict("ValidateSpatialOccupancy", True, "no shared voxel over 4.2 s")
    content = Content(path)
    lane = "/checks/ValidateSpatialOccupancy"
    reason = (
        "agent 1 and agent 2: Agent_1 and Agent_2 touch each other with 31 N (31 N, bound 1 N, at 1.35 s)"
    )
    assert content.texts(lane)[0] == f"ValidateSpatialOccupancy: {reason}"
    assert content.texts(lane)[-1] == "ValidateSpatialOccupancy: no shared voxel over 4.2 s"
    assert content.texts("/checks/Motion") == [
        "Motion: agent 1: Agent_1 cannot go home: no free path (at 0.20 s)"
    ]
    assert content.column(lane, "StateChange:state") == [["violated"], ["violated"], ["holds"]]
    assert content.steps(lane, "StateChange:state") == [0, 0, 3]
    assert content.column(lane, "StateConfiguration:values") == [["holds", "violated"]]
    markers = content.column("/world/violations", "Points3D:positions")[-1]
    np.testing.assert_allclose(markers, [[0.0, 0.1, 0.3], [0.0, -0.1, 0.3], [0.0, 0.2, 0.3]], atol=1e-6)


def test_lanes_distinguish_motion_and_waiting(path):
    with open_recorder(path) as recorder:
        recorder.motion(1, "grasp barrier at left", "approach")
        recorder.step(3, poses=POSES, qpos=QPOS)
        recorder.motion(1, "lift barrier by 0.2 m", "")
        recorder.step(4, poses=POSES, qpos=QPOS)
        recorder.motion(1, "lift barrier by 0.2 m", "lift")
        recorder.motion(1, "", "")
    content, lane = Content(path), "/motions/agent1"
    states = [state for row in content.column(lane, "StateChange:state") for state in row]
    labels = ["approach: grasp barrier at left", "waits", "lift: lift barrier by 0.2 m"]
    assert states == [*labels, ""]
    assert content.steps(lane, "StateChange:state") == [0, 3, 4, 4]
    assert content.column(lane, "StateConfiguration:values")[-1] == labels
    colours = [PRIMITIVES["approach"], WAITS, PRIMITIVES["lift"]]
    colour_codes = content.column(lane, "StateConfiguration:colors")[-1]
    assert [(each >> 24, each >> 16 & 255, each >> 8 & 255) for each in colour_codes] == colours


CONTACT = Violation(
    check=CheckName.OCCUPANCY, cause=Cause.SPACE, finding=Finding.TOUCHING, value=31.0, bound=1.0, unit="N",
    time_s=1.35, agents=(1, 2), measured=True,
)  # fmt: skip


def test_the_check_code_shows_its_evidence_and_replaces_the_previous_one(path):
    with open_recorder(path) as recorder:
        recorder.violation(BLOCKED)
        recorder.plan_checks(RESULTS)
        recorder.step(5, poses=POSES, qpos=QPOS)
        recorder.plan_checks(RESULTS[:1])
    content = Content(path)
    [violation], [first], [both] = content.column("/plan/checks", "TextDocument:text")
    assert (
        violation
        == "## Violation 1, step 0\n\n**Motion**: agent 1: Agent_1 cannot go home: no free path (at 0.20 s)"
    )
    assert first.startswith("## Check code 1, step 0")
    assert both.endswith(first)
    assert both.startswith("## Check code 2, step 5\n\n**True**: all 1 checks hold.")
    assert "**False**: 1 of 3 checks are violated." in first
    assert "and VSO(Agent_1)  # VIOLATED: 0.004 m, bound 0.01 m\n" in first
    assert "| **violated** | `VSO(Agent_1)` | 0.004 m | 0.01 m | 2.00 s | too near |" in first
    assert "| `VSO(Agent_2, objects)` | none | 0.003 m |" in first
    assert "2 mm \\| off" in first  # unescaped, it would end the cell

    def lane(name: str) -> list[str]:
        return [state for row in content.column(f"/checks/{name}", "StateChange:state") for state in row]

    assert lane("VI-Agent_1-barrier-left") == ["holds", "holds"]
    assert lane("VSO-Agent_1") == ["violated", ""]
    assert lane("Motion") == ["violated", ""]


def test_the_marker_of_a_violation_disappears_after_half_a_second(path):
    with open_recorder(path) as recorder:
        recorder.violation(CONTACT, [(0.0, 0.1, 0.3)])
        for step in (5, 9, 10, 11):
            recorder.step(step, poses=POSES, qpos=QPOS)
    content = Content(path)
    assert content.steps("/world/violations", "Clear:is_recursive") == [10]


def test_documents_list_attempts_newest_first(path):
    goals = (Subgoal(1, "grasp", "barrier", "left"), Subgoal(2, "grasp", "barrier", "right"))
    proposal = Proposal(goals, (Together((1, 2), "lift", "barrier"),))
    with open_recorder(path) as recorder:
        recorder.proposal(proposal)
        recorder.proposal(proposal)
    content = Content(path)
    [shown] = content.column("/plan/proposals", "TextDocument:text")[-1]
    assert shown.index("Proposal 2, step 0") < shown.index("Proposal 1, step 0")
    assert "1. grasp barrier at left" in shown
    assert "- *temporal*, agents 1, 2: Agent_1 and Agent_2 must lift barrier simul" in shown
    assert "agent 2 is to grasp barrier at right" in content.texts("/log")


def test_conditions_are_lanes_and_numbers_are_curves(path):
    with open_recorder(path, panels="rollout") as recorder:
        recorder.condition("held by both arms", False, "held by both arms: not yet")
        recorder.condition("arms apart", True, "arms apart: holds", ("holds", "touching"))
        recorder.step(2, poses=POSES, qpos=QPOS)
        recorder.condition("held by both arms", True, "held by both arms: holds")
        recorder.condition("arms apart", False, "arms apart: touching", ("holds", "touching"))
        for name, value in (("lifted (> 0.15 m)", 0.5), ("level (< 5 deg)", 2.0)):
            recorder.margin(name, value)
        recorder.distance(1, 2, 0.125)
        recorder.contact("agent 1 on barrier", 7.5)
        recorder.judgement(Markdown("so far"))
    content = Content(path)

    def lane(name: str, component: str) -> list:
        return content.column(f"/conditions/{name}", component)

    assert lane("held-by-both-arms", "StateChange:state") == [["not yet"], ["holds"]]
    assert lane("held-by-both-arms", "TextLog:text")[-1] == ["held by both arms: holds"]
    colours = {
        name: lane(name, "StateConfiguration:colors")[0] for name in ("held-by-both-arms", "arms-apart")
    }
    red = [[each >> 24, each >> 16 & 255, each >> 8 & 255] for each in (pair[1] for pair in colours.values())]
    assert red[0] != red[1] == list(VIOLATED)  # a condition that does not hold yet is not a violation
    assert content.column("/margins/lifted\\ \\(\\>\\ 0.15\\ m\\)", "Scalars:scalars") == [[0.5]]
    assert content.column("/arms/distances/agents\\ 1\\ and\\ 2", "Scalars:scalars") == [[12.5]]  # cm
    assert content.column("/contacts/agent\\ 1\\ on\\ barrier", "Scalars:scalars") == [[7.5]]
    assert content.column("/verdict", "TextDocument:text") == [["so far"]]


def test_the_verdict_is_a_table_and_its_end_a_list():
    up = Measured(False, 0.02, 0.15, "m", above=True)
    verdict = Verdict(False, False, {"held": True, "up": False}, {"up": up}, {"steak": "dropped"})
    lines = text.conditions(verdict, {"held": 20, "up": 0}).splitlines()
    rows = ["| holds | held |  |  | 1.00 s |", "| **not yet** | up | 0.02 m | > 0.15 | 0.00 s |"]
    assert lines[2:] == [*rows, "", "- steak is dropped"]
    account = Account(unmet=(Unmet("up; or down", 0.0),), closest=Closest(1, 2, 1.0, 0))
    outcome = text.outcome(Rollout(3, False, False, 84, 2, 1, account))
    assert outcome.startswith("**Failed after 4.20 s**")
    assert "2 steps with a violation, 1 with contact between arms." in outcome
    assert outcome.endswith("- failed: up; or down (never)\n- at best 1 of 2 (1.00 s)")
