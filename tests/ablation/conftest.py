"""Result rows for tables and reports, made by hand so that every expected figure can be counted."""

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest

from rf_exp.ablation import EvaluationRow, GenerationRow, append_row, configured, publish
from rf_exp.findings import Account, Cause, CheckName, Finding, Unmet, Violation

BUDGET = 4  # violations that end an attempt


def generation(
    task: str, constraints: str, wins: int, losses: int, *, steps: int = 100, version: str = "1",
    brain: str = "scripted", loose: int = 0, first: int = 0, violations: Sequence[int] = (0,),
) -> list[GenerationRow]:  # fmt: skip
    """`wins` successes of steps, steps + 1, ..., then failures, `loose` of them successes for the paper.

    `violations` has one number per row, at most BUDGET, and is repeated if it is shorter.
    """
    return [
        GenerationRow(
            task=task, constraints=constraints, brain=brain, seed=first + i, success=i < wins,
            success_paper=i < wins + loose, steps=steps + i,
            attempts=broken + 1 if i < wins else min(broken + 1, BUDGET),
            wall_s=2.0, version=version, violations=broken, contacts=0, generator="1.1", commit="",
            account=Account() if i < wins else failed(i, broken),
        )
        for i, broken in zip(range(wins + losses), cycle(violations), strict=False)
    ]  # fmt: skip


def failed(i: int, broken: int) -> Account:
    """Account of a failure, as the loop of generation gives it, with numbers that depend on seed `i`."""
    close = Violation(
        check=CheckName.OCCUPANCY, cause=Cause.SPACE, finding=Finding.TOUCHING, value=10.0 + i, bound=1.0,
        unit="N", time_s=0.1 * i, agents=(1, 2), measured=True,
    )  # fmt: skip
    return Account(
        unmet=(Unmet("lifted", 0.05 * i, 0.01 * i, 0.1, 0.15, "m", True),), rejections=(close,) * broken
    )


def evaluation(
    task: str, arch: str, demos: int, wins: int, losses: int, *, version: str = "1",
    constraints: str = "full", train_seed: int = 0, violations: Sequence[int] = (0,),
    shield: bool = False, interventions: int = 0, contacts: int = 0, **more: Any,
) -> list[EvaluationRow]:  # fmt: skip
    return [
        EvaluationRow(
            task=task, arch=arch, constraints=constraints, demos=demos, train_seed=train_seed,
            scene_seed=1_000_000 + i, success=i < wins, success_paper=i < wins, steps=100, step_limit=200,
            violations=touched, wall_s=5.0, version=version, contacts=0 if i < wins else contacts,
            commit="", shield=shield, interventions=interventions,
            account=Account() if i < wins else Account(unmet=(Unmet("lifted", 0.0),)), **more,
        )
        for i, touched in zip(range(wins + losses), cycle(violations), strict=False)
    ]  # fmt: skip


def write_report(out: Path) -> Path:
    """The report on an output folder, for the tasks of the suite."""
    return publish(out, configured())[1]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An output folder with rows of two tasks."""
    rows = [
        *generation("lift_barrier", "logical", 6, 4, loose=2),
        *generation("lift_barrier", "full", 10, 0, steps=80),
        *generation("new_task", "full", 0, 3),
    ]
    for row in rows:
        append_row(tmp_path / f"results/generate/{row.task}/{row.constraints}.jsonl", row)
    for row in [
        *evaluation("lift_barrier", "separate_local", 150, 12, 8),
        *evaluation("lift_barrier", "shared_global", 150, 5, 15),
    ]:
        append_row(tmp_path / f"results/evaluate/{row.task}/{row.arch}/full-{row.demos}.jsonl", row)
    return tmp_path
