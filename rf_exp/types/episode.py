"""What was done: a demonstration, or the rollout of a policy."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rf_exp.findings import Account, Violation
from rf_exp.types.scene import Scene
from rf_exp.types.success import Judged, Verdict


@dataclass(frozen=True)
class Episode:
    """One executed episode. Row t is observed before action t is applied."""

    task: str
    seed: int
    qpos: NDArray[np.float32]  # (T, N, 9) measured
    qvel: NDArray[np.float32]  # (T, N, 9)
    action: NDArray[np.float32]  # (T, N, 8) joint targets rad + gripper command, as intended
    images: Mapping[str, NDArray[np.uint8]]  # camera -> (T, H, W, 3); empty without rendering
    certificate: Mapping[str, object] = field(default_factory=dict)  # JSON: checks and results, subgoals
    executed: NDArray[np.float32] | None = None  # (T, N, 8) what the arms were told; None: `action`
    poses: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    # object -> (T, 7) position in m and quaternion w, x, y, z, world frame
    subgoal: NDArray[np.int16] | None = None  # (T, N) each agent's, an index of certificate["subgoals"]
    judged: Judged | None = None
    extras: Mapping[str, NDArray] = field(default_factory=dict)
    # depth_<camera> -> (T, H, W) u16 mm, segmentation_<camera> -> (T, H, W) u8; those that were asked for

    @property
    def commanded(self) -> NDArray[np.float32]:
        """(T, N, 8) what the arms were told: played again from the seed, it gives this episode again."""
        return self.action if self.executed is None else self.executed


@dataclass(frozen=True)
class KeypointDetection:
    """A keypoint in a picture, detected by a policy: where an agent will be, or where another one is."""

    camera: str
    agent: int
    x: float  # to the right, from 0 to 1 over the picture
    y: float  # down
    is_next: bool  # whether it is where this agent goes next


@dataclass(frozen=True)
class RolloutStep:
    """One control step of a rollout, as its observers are told of it."""

    scene: Scene  # after the step
    action: NDArray[np.float64]  # (N, 8) as commanded: joint targets rad + gripper command
    predicted: Mapping[
        int, NDArray[np.float64]
    ]  # agent -> (T, 8) targets from this step on, where it predicted
    verdict: Verdict
    violation: Violation | None  # seen by the monitor
    withheld: Mapping[int, str] | None = None  # agent -> why a shield kept its command; None without one
    detections: tuple[KeypointDetection, ...] = ()  # in the pictures that policies looked at last
    # agent -> the number of its subgoal and whether it may go on, as its policy said at its last prediction
    phases: Mapping[int, tuple[int, bool]] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollout:
    """What happened when a policy acted in one scene."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    violations: int  # control steps with a violation, seen by the monitor
    contacts: int  # control steps in which arms touched each other
    account: Account = field(
        default_factory=Account
    )  # which arms touched, which violations were seen, what failed
    interventions: int = 0  # control steps in which a shield kept an agent from its command

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty for a success."""
        return "" if self.success else self.account.reason
