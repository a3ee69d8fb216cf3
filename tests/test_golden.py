"""Bytes of demonstrations change only with a version: that of the generator, of a plan or of the criteria."""

import sys
from typing import Any

import pytest

from rf_exp.datagen.motion import verbs
from rf_exp.tasks import Task, pick_meat
from tests import golden
from tests.conftest import TASKS, read_task

FULL = [row for row in golden.rows() if row.name == "full"]


@pytest.mark.slow
def test_the_first_seeds_are_as_recorded(task: Task) -> None:
    recorded, found = golden.read().get(task.name), golden.digests_of(task, golden.rows())
    problem = golden.required_action(task, recorded, found)
    assert not problem, problem
    if golden.differs_by_processor(recorded, found):
        pytest.skip(f"plans and judgement are as recorded; bytes are those of {recorded['processor']}")  # pyright: ignore[reportOptionalSubscript]


def test_the_file_holds_every_task_and_row() -> None:
    recorded = golden.read()
    assert sorted(recorded) == sorted(TASKS)
    assert all(list(digests["rows"]) == [row.name for row in golden.rows()] for digests in recorded.values())


def action_after_change(task: Task, recorded: dict[str, Any]) -> str:
    return golden.required_action(task, recorded, golden.digests_of(task, FULL))


@pytest.mark.slow
def test_the_changed_part_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Changes the plan, the criteria and the generator in turn."""
    task = read_task("pick_meat")
    recorded = golden.digests_of(task, FULL)
    assert action_after_change(task, recorded) == ""
    assert golden.required_action(task, None, recorded).startswith("pick_meat has no digests; then take")

    with monkeypatch.context() as patch:
        patch.setattr(pick_meat, "LIFT_M", 0.18)
        assert (
            "its plan changed, and its versions did not; raise PLAN_VERSION in rf_exp.tasks.pick_meat"
            in action_after_change(task, recorded)
        )
        patch.setattr(pick_meat, "PLAN_VERSION", "2")
        assert action_after_change(task, recorded).endswith(
            "take its digests anew: python -m tests.golden pick_meat"
        )

    with monkeypatch.context() as patch:
        patch.setattr(pick_meat, "still", lambda *_: True)  # counts as solved earlier
        assert "when it counts as solved (rows full) changed" in action_after_change(task, recorded)
        assert "raise VERSION in rf_exp.tasks.pick_meat" in action_after_change(task, recorded)

    with monkeypatch.context() as patch:
        patch.setattr(verbs, "GRIPPER_STEPS", 12)
        assert "its bytes (rows full) changed" in action_after_change(task, recorded)
        assert "raise GENERATOR in rf_exp.datagen.version, or PLAN_VERSION" in action_after_change(
            task, recorded
        )


@pytest.mark.slow
def test_digests_are_not_updated_under_the_same_versions(
    monkeypatch: pytest.MonkeyPatch, tmp_path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(golden, "FILE", tmp_path / "golden.json")
    monkeypatch.setattr(golden, "rows", lambda: FULL)
    monkeypatch.setattr(sys, "argv", ["golden", "pick_meat"])
    assert golden.main() == 0
    before = golden.read()
    monkeypatch.setattr(pick_meat, "LIFT_M", 0.18)
    assert golden.main() == 1 and golden.read() == before
    assert "raise PLAN_VERSION" in capsys.readouterr().err
    monkeypatch.setattr(pick_meat, "PLAN_VERSION", "2")
    assert golden.main() == 0 and golden.read() != before
