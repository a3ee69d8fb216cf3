"""Rows of schema 5 and before: the sentence that told why an attempt failed, as an account.

The one place that reads such a sentence. That of a rollout tells everything. That of a generation tells which
conditions did not hold; what it says of violations stays words, without their decimal numbers, so that equal
failures are equal. Nothing can be told of arms that touched in an attempt that succeeded.
"""

import re
from collections.abc import Mapping
from typing import Any

from rf_exp.errors import ArgumentError

_UNMET = re.compile(
    r"(?P<name>[^()]+?) \((?:never|since (?P<since>[\d.]+) s)"
    r"(?:: (?P<value>\S+) (?P<unit>[^,)]+?)(?:, best (?P<best>[^,)]+))?"
    r", asked (?P<side>[<>]) (?P<bound>[^)]+))?\)"
    r"(?:, |$)"
)
_CLOSEST = re.compile(
    r"at best (?P<holding>\d+) of (?P<of>\d+)(?: \((?P<at>[\d.]+) s(?:, for (?P<steps>\d+) steps)?\))?"
)
_TOUCHED = re.compile(r"agents (\d+) and (\d+) touched \(([\d.]+) s, (\d+) steps\)")
_LOST = re.compile(r"(.+) (dropped|out of reach|off the table) \(([\d.]+) s\)")
_SHORT = re.compile(r"failed: all conditions held, but not for long \((\d+) steps at the end\)")
_DECIMAL = re.compile(r"-?\d+\.\d+")
_TOO_SHORT = "success was not held long enough"  # in which order or how long is not told
_ENDED = ("refused: ", "no result after ", "nothing to correct")


def upgraded(values: Mapping[str, Any]) -> dict[str, Any]:
    """The plain values of an older row with an account. Raises ArgumentError for a reason of another form."""
    row = {name: value for name, value in values.items() if name != "reason"}
    reason = values.get("reason", "")
    if not isinstance(reason, str):
        raise ArgumentError(f"reason is {reason!r}; expected a sentence")
    return row | {"account": _account(reason)}


def _account(reason: str) -> dict[str, Any]:
    if not reason:
        return {}
    if reason.startswith(_ENDED):
        return {"ended": _DECIMAL.sub("…", reason)}
    if reason.startswith("failed: "):
        return _of_rollout(reason)
    failed, _, told = reason.partition("; ")
    account: dict[str, Any] = {"told": _DECIMAL.sub("…", told)}
    if failed != _TOO_SHORT:
        if not failed.startswith("not "):
            raise ArgumentError(f"reason {reason!r} has none of the forms of older rows")
        names = failed.removeprefix("not ").split(", not ")
        account["unmet"] = [{"name": name} for name in names]
    return account


def _of_rollout(reason: str) -> dict[str, Any]:
    first, *rest = reason.split("; ")
    account: dict[str, Any] = {"unmet": [], "touches": [], "lost": []}
    if short := _SHORT.fullmatch(first):
        account["closest"] = {"holding": 0, "of": 0, "time_s": 0.0, "steps": int(short[1])}
    elif first != f"failed: {_TOO_SHORT}":
        account["unmet"] = _conditions(first.removeprefix("failed: "))
    for part in rest:
        if found := _CLOSEST.fullmatch(part):
            holding, of, at, steps = found.groups(default="0")
            account["closest"] = {
                "holding": int(holding), "of": int(of), "time_s": float(at), "steps": int(steps)
            }  # fmt: skip
        elif found := _TOUCHED.fullmatch(part):
            a, b, at, steps = found.groups()
            account["touches"].append({"agents": [int(a), int(b)], "time_s": float(at), "steps": int(steps)})
        elif found := _LOST.fullmatch(part):
            account["lost"].append({"object": found[1], "how": found[2], "time_s": float(found[3])})
        else:
            raise ArgumentError(f"{part!r} in the reason of a rollout has none of the forms of older rows")
    return account


def _conditions(text: str) -> list[dict[str, Any]]:
    conditions, at = [], 0
    while at < len(text):
        found = _UNMET.match(text, at)
        if found is None:
            raise ArgumentError(f"{text[at:]!r} in the reason of a rollout is no condition that did not hold")
        at, told = found.end(), found.groupdict()
        one: dict[str, Any] = {"name": told["name"], "since_s": float(told["since"] or 0.0)}
        if told["value"] is not None:
            best = told["best"] or (None if told["since"] else told["value"])
            one |= {"value": float(told["value"]), "best": None if best is None else float(best)}
            one |= {"unit": told["unit"], "bound": float(told["bound"]), "above": told["side"] == ">"}
        conditions.append(one)
    return conditions
