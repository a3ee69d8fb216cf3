"""The account of a failed rollout and its sentence, from steps made by hand."""

import numpy as np

from rf_exp.tasks import Ledger
from rf_exp.types import Measured, Scene, Verdict


def seen(*verdicts: Verdict, contacts: dict[int, tuple[tuple[int, int, float], ...]] | None = None) -> Ledger:
    """An account of so many steps, arms touching in those of `contacts`."""
    account, none = Ledger(), np.zeros((2, 9))
    for step, verdict in enumerate(verdicts, start=1):
        touching = (contacts or {}).get(step, ())
        account.record(Scene(step, none, none, {}, {}, (None, None), arm_contacts=touching), verdict)
    return account


def verdict(measured: dict[str, Measured] | None = None, lost: dict[str, str] | None = None, **holds: bool):
    return Verdict(False, False, holds, measured or {}, lost or {})


def test_without_one_step_nothing_was_carried_out() -> None:
    account = seen().account(False)
    assert account.reason == "failed: nothing was carried out"
    assert account.kind == "nothing was carried out"


def test_conditions_tell_since_when_they_fail_and_what_was_best() -> None:
    account = seen(
        verdict(held=False, up=False, level=True),
        verdict(held=True, up=False, level=True),
        verdict(held=False, up=False, level=True),
        verdict(held=False, up=False, level=True),
    )
    assert account.account(False).reason == "failed: held (since 0.15 s), up (never); at best 2 of 3 (0.10 s)"


def up(value: float) -> dict[str, Measured]:
    return {"up": Measured(value > 0.15, value, 0.15, "m", above=True)}


def test_a_condition_with_a_number_tells_its_end_and_its_best() -> None:
    account = seen(*(verdict(up(value), up=False) for value in (0.0, 0.113, 0.02)))
    assert (
        account.account(False).reason == "failed: up (never: 0.02 m, best 0.11, asked > 0.15); at best 0 of 1"
    )
    level = [{"level": Measured(v < 5, v, 5.0, "deg", above=False)} for v in (1.0, 7.2)]
    account = seen(verdict(level[0], level=True), verdict(level[1], level=False))
    assert account.account(False).reason == (
        "failed: level (since 0.10 s: 7.2 deg, asked < 5); at best 1 of 1 (0.05 s, for 1 steps)"
    )


def test_numbers_of_another_bound_are_no_best() -> None:
    """A thing may have to be near and then low: its distance is no height."""
    near, low = Measured(False, 0.01, 0.005, "m", above=False), Measured(False, 0.3, 0.05, "m", above=False)
    reason = (
        seen(verdict({"into": near}, into=False), verdict({"into": low}, into=False)).account(False).reason
    )
    assert "into (never: 0.3 m, asked < 0.05)" in reason


def test_arms_that_touched_and_things_that_were_lost_are_told() -> None:
    account = seen(
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


def test_conditions_that_hold_too_late_are_no_success() -> None:
    account = seen(verdict(up=False), verdict(up=True), verdict(up=True))
    assert account.account(False).reason == "failed: all conditions held, but not for long (2 steps)"


def test_a_score_is_the_largest_part_that_held_at_once_and_only_success_is_all() -> None:
    """As in rows: what holds now and then adds nothing up, and what was reached is never taken back."""
    steps = [
        verdict(held=False, up=False, level=True),
        verdict(held=True, up=False, level=False),
        verdict(held=True, up=False, level=True),
        verdict(held=True, up=True, level=True),  # but not yet for long
        verdict(held=False, up=False, level=False),
    ]
    scores = [seen(*steps[:k]).score for k in range(len(steps) + 1)]
    assert scores == [0, 1 / 4, 1 / 4, 2 / 4, 3 / 4, 3 / 4]
    closest = seen(*steps).account(False).closest
    assert closest is not None and closest.score == scores[-1]
    assert seen(*steps, Verdict(True, True, {"held": True, "up": True, "level": True})).score == 1
