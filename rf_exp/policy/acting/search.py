"""Search along camera rays: where the next attempt goes after a failed grasp or press.

A picture tells least about the distance of a point along its ray. Fingers that have closed on nothing add no
information, so the next grasp is tried farther along the ray, then nearer. Fingers that are stopped while
they press measure the height of a surface, and the goal is where the ray has that height; fingers that are
not stopped go on farther along the ray.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field

STEPS = (0, 1, -1, 2, -2)  # steps along the ray at the first attempt, after a first failed grasp, ...
MOST_PRESS_SHIFT_M = 0.06
LEAST_SLOPE = 0.1  # of a ray; where a flatter one reaches a height is too uncertain
SAME_PLACE_M = 0.005  # a press is not repeated if its goal has shifted by less than this

Key = tuple[int, int]  # agent, number of its gripper change


@dataclass
class Search:
    """The displacements of an episode."""

    step_m: float  # 0: no search
    failed_grasps: Counter[Key] = field(default_factory=Counter)
    press_shifts_m: defaultdict[Key, float] = field(default_factory=lambda: defaultdict(float))

    def shift_m(self, agent: int, change: int) -> float:
        """Displacement along the ray, away from the camera, of the goal of the next change of a gripper."""
        step = STEPS[self.failed_grasps[agent, change] % len(STEPS)]
        return self.step_m * step + self.press_shifts_m[agent, change]

    def press_failed(self, agent: int, change: int, below_m: float, slope: float, *, blocked: bool) -> bool:
        """Shift the goal of the next press; returns whether there is a next one.

        The fingers stand `below_m` below the detected goal, and the ray falls by `slope` per metre. They are
        blocked if they stand still short of where they are commanded to.
        """
        last_m = self.press_shifts_m[agent, change]
        shift_m = below_m / slope if blocked and slope > LEAST_SLOPE else last_m + self.step_m
        shift_m = min(max(shift_m, -MOST_PRESS_SHIFT_M), MOST_PRESS_SHIFT_M)
        self.press_shifts_m[agent, change] = shift_m
        return abs(shift_m - last_m) >= SAME_PLACE_M
