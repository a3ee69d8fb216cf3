"""The account of a failed rollout and its sentence, from constructed steps."""

import numpy as np

from rf_exp.tasks import Ledger
from rf_exp.types import Measured, Scene, Verdict


def ledger_of(
    *verdicts: Verdict, contacts: dict[int, tuple[tuple[int, int, float], ...]] | None = None
) -> Ledger:
    """A ledger of one step per verdict; `contacts`: step -> contacts of arms."""
    account, none = Ledger(), np.zeros((2, 9))
    for step, verdict in enumerate(verdicts, start=1):
        touching = (contacts or {}).get(step, ())
        account.record(Scene(step, none, none, {}, {}, (None, None), arm_contacts=touching), verdict)
    return account


def verdict(measured: dict[str, Measured] | None = None, lost: dict[str, str] | None = None, **holds: bool):
    return Verdict(False, False, holds, measured or {}, lost or {})


def test_an_account_without_steps() -> None:
    account = ledger_of().account(False)
    assert account.reason == "failed: nothing was carried out"
    assert account.kind == "nothing was carried out"


def test_conditions_report_since_when_they_fail_and_the_best_step() -> None:
    account = ledger_of(
        verdict(held=False, up=False, level=True),
        verdict(held=True, up=False, level=True),
        verdict(held=False, up=False, level=True),
        verdict(held=False, up=False, level=True),
    )
    assert account.account(False).reason == "failed: held (since 0.15 s), up (never); at best 2 of 3 (0.10 s)"


def up(value: float) -> dict[str, Measured]:
    return {"up": Measured(value > 0.15, value, 0.15, "m", above=True)}


def test_a_condition_with_a_number_reports_its_last_and_best_value() -> None:
    account = ledger_of(*(verdict(up(value), up=False) for value in (0.0, 0.113, 0.02)))
    assert (
        account.account(False).reason == "failed: up (never: 0.02 m, best 0.11, asked > 0.15); at best 0 of 1"
    )
    level = [{"level": Measured(v < 5, v, 5.0, "deg", above=False)} for v in (1.0, 7.2)]
    account = ledger_of(verdict(level[0], level=True), verdict(level[1], level=False))
    assert account.account(False).reason == (
        "failed: level (since 0.10 s: 7.2 deg, asked < 5); at best 1 of 1 (0.05 s, for 1 steps)"
    )


def test_values_with_another_bound_are_not_the_best() -> None:
    """An object may first have to be near and then low: a distance is not a height."""
    near, low = Measured(False, 0.01, 0.005, "m", above=False), Measured(False, 0.3, 0.05, "m", above=False)
    reason = (
        ledger_of(verdict({"into": near}, into=False), verdict({"into": low}, into=False))
        .account(False)
        .reason
    )
    assert "into (never: 0.3 m, asked < 0.05)" in reason


def test_contacts_and_lost_objects_are_reported() -> None:
    account = ledger_of(
        verdict(up=False),
        verdict(up=False, lost={"steak": "dropped"}),
        verdict(up=False),
        verdict(up=False, lost={"steak": "off the table"}),
        contacts={2: ((1, 2, 30.0),), 3: ((1, 2, 3.0), (2, 3, 1.0))},
    )
    assert account.contacts == 2
    assert account.account(False).reason == (
        "failed: up (never); at best 0 of 1; agents 1 and 2 touched (0.10 s, 2 steps); "
        "agents 2 and 3 touched (0.15 s, 1 steps); steak dropped (0.10 s); steak off the table (0.20 s)"
    )


def test_conditions_that_hold_too_late_are_not_a_success() -> None:
    account = ledger_of(verdict(up=False), verdict(up=True), verdict(up=True))
    assert account.account(False).reason == "failed: all conditions held, but not for long (2 steps)"


def test_the_score_is_the_largest_fraction_of_conditions_at_once_and_one_only_for_success() -> None:
    """As in rows: conditions that held at different times do not add up, and the score never decreases."""
    steps = [
        verdict(held=False, up=False, level=True),
        verdict(held=True, up=False, level=False),
        verdict(held=True, up=False, level=True),
        verdict(held=True, up=True, level=True),  # but not yet long enough
        verdict(held=False, up=False, level=False),
    ]
    scores = [ledger_of(*steps[:k]).score for k in range(len(steps) + 1)]
    assert scores == [0, 1 / 4, 1 / 4, 2 / 4, 3 / 4, 3 / 4]
    closest = ledger_of(*steps).account(False).closest
    assert closest is not None and closest.score == scores[-1]
    assert ledger_of(*steps, Verdict(True, True, {"held": True, "up": True, "level": True})).score == 1
