"""A plan with the verdicts on it: violations, certificate, and the monitor of its execution."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rf_exp.constraints.evidence import Check, Evidence, violation
from rf_exp.constraints.monitor import Monitor
from rf_exp.constraints.plan import Plan
from rf_exp.findings import Violation
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M
from rf_exp.types import CONTROL_DT_S


@dataclass(frozen=True, eq=False)
class CheckedPlan:
    """A plan, the checks of its row, and what each found before anything moves."""

    plan: Plan
    checks: tuple[Check, ...]
    evidence: tuple[Evidence, ...]  # of each check

    @property
    def violations(self) -> list[Violation]:
        """Of the checks that failed, earliest first."""
        found = zip(self.checks, self.evidence, strict=True)
        failed = [violation(check, evidence) for check, evidence in found if not evidence.ok]
        return sorted(failed, key=lambda each: each.time_s)

    def monitor(self) -> Monitor:
        """Watches one execution of the plan."""
        return Monitor(self.plan, self.checks)

    def certificate(self) -> dict[str, Any]:
        """What was checked before execution and with what result; plain JSON values."""
        timed = self.plan.schedule
        return {
            "row": self.plan.constraint_set.name,
            "margins_m": {"agents": AGENT_MARGIN_M, "objects": OBJECT_MARGIN_M},
            "makespan_s": len(timed) * CONTROL_DT_S,
            "makespan_bound_s": timed.makespan_bound * CONTROL_DT_S,
            "checks": [
                {
                    "check": check.name,
                    "kind": check.kind,
                    "code": repr(check),
                    "text": check.text,
                    "ok": bool(evidence.ok),
                    "value": float(evidence.value) if np.isfinite(evidence.value) else None,
                    "bound": float(evidence.bound),
                    "time_s": float(evidence.time_s),
                    "reason": evidence.sentence,
                }
                for check, evidence in zip(self.checks, self.evidence, strict=True)
            ],
        }
