"""What is counted while a policy acts."""

from itertools import combinations

from rf_exp.constraints.checks import AvoidAgentsCheck
from rf_exp.constraints.evidence import violation
from rf_exp.constraints.touching import touching
from rf_exp.findings import Violation
from rf_exp.tasks import Task
from rf_exp.types import Scene


class PolicyMonitor:
    """Watches a policy act: arms that touch or overlap, nothing else. For counting, not for stopping.

    What a policy is about is unknown, so a gripper, or what it holds, may meet what another one holds.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs = tuple(combinations(task.agents, 2))
        self._may_touch = dict.fromkeys(task.agents, frozenset(task.objects))

    def __call__(self, scene: Scene) -> Violation | None:
        found = touching(self._task, scene, self._pairs, self._may_touch)
        if found is None:
            return None
        return violation(AvoidAgentsCheck(found.agents), found)
