"""Every annotated grasp in the simulator: the gripper closes and lifts; the asset follows without tilt."""

import numpy as np
import pytest
from scipy.interpolate import interp1d

from rf_exp.datagen.motion import branches as motion
from rf_exp.robots import Arm
from rf_exp.sim import Simulator
from rf_exp.tasks import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Task, assets, default_of
from rf_exp.tasks.predicates import tilt_deg
from rf_exp.transforms import Matrix, inverse, transform
from rf_exp.types import GRIPPER_CLOSED, GRIPPER_OPEN, JointLimits
from tests.tasks.test_assets import about

LIFT_M = 0.12
LIMITS = JointLimits(**default_of("limits"))
REST_RAD = (0.0, -0.2, 0.0, -2.3, 0.0, 2.1, np.pi / 4)  # retracted, clear of the object in the middle
CASES = [
    (name, tip_deg)
    for name in assets.available()
    for grips in [[point for point in assets.load(name).points.values() if point.kind == "grasp"]]
    if grips
    for tip_deg in sorted({0.0, grips[0].tip_deg, -grips[0].tip_deg})
]


class Arms:
    """Drives the arms of a simulator to TCP poses without collision avoidance."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator, self.scene = simulator, simulator.reset(0)
        self.arms = tuple(simulator.task.arms.values())

    def go(self, goals: list[Matrix], gripper: float, *, straight: bool = True, steps: int = 30) -> None:
        command = self.simulator.command
        paths = []
        for arm, joints, goal in zip(self.arms, command[:, :7], goals, strict=True):
            if straight:
                line = motion.straight_line(arm, joints, goal, LIMITS)
            else:
                line = np.stack([joints, _facing_joints(arm, goal)])
            assert line is not None, f"no way to {goal[:3, 3]}"
            paths.append(interp1d(np.linspace(0, 1, len(line)), line, axis=0))
        for fraction in [*np.linspace(0, 1, steps)[1:], *[1.0] * 10]:
            command[:, :7] = [line(fraction) for line in paths]
            command[:, 7] = gripper
            self.scene = self.simulator.step(command)


def _facing_joints(arm: Arm, goal: Matrix) -> np.ndarray:
    goal_m = (inverse(arm.world_from_base) @ goal)[:2, 3]
    joints = arm.solve(
        goal, np.array([np.arctan2(goal_m[1], goal_m[0]), *REST_RAD[1:-1], arm.preferred_last_rad(goal)])
    )
    assert joints is not None, f"{goal[:3, 3]} is out of reach"
    return joints


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tip_deg"), CASES)
def test_a_lifted_asset_stays_in_the_gripper_without_tilt(name: str, tip_deg: float) -> None:
    grips = [point for point in assets.load(name).points.values() if point.kind == "grasp"]
    from_above = grips[0].object_from_tcp[2, 2] < -0.5
    # Far enough that grippers do not start above the object.
    distance_m = 0.85 if len(grips) == 2 else 0.55 if from_above else 0.75
    robots = tuple(RobotSpec(0, side * distance_m, -90 * side, REST_RAD) for side in (-1, 1)[: len(grips)])
    plinth = {"plinth": ObjectSpec("plinth")} if name == "camera" else {}
    yaw_deg = 90.0 if name == "barrier" else 0.0  # so that its ends point at the arms
    spec = ObjectSpec(name, z_m=0.12 if plinth else 0.0, yaw_deg=(yaw_deg, yaw_deg))
    cameras = {name: CameraSpec() for name in ("global", *(f"agent{k + 1}" for k in range(len(grips))))}
    objects = plinth | {"it": spec}
    task = Task("grip", "", "", "", robots, objects, cameras, {}, Randomisation(0, 0, 0, 0))
    with Simulator(task, render=False) as simulator:
        arms = Arms(simulator)
        start = arms.scene.poses["it"]
        goals = [start @ point.object_from_tcp @ about("y", tip_deg) for point in grips]
        pregrasps = [
            goal @ transform((0, 0, -point.standoff_m)) for goal, point in zip(goals, grips, strict=True)
        ]
        arms.go(pregrasps, GRIPPER_OPEN, straight=False, steps=50)
        arms.go(goals, GRIPPER_OPEN)
        np.testing.assert_allclose(arms.scene.poses["it"], start, atol=0.001)  # nothing touched it
        arms.go(goals, GRIPPER_CLOSED, steps=2)
        arms.go([transform((0, 0, LIFT_M)) @ goal for goal in goals], GRIPPER_CLOSED)
        end = arms.scene.poses["it"]
    assert arms.scene.held == ("it",) * len(grips)
    np.testing.assert_allclose(end[:3, 3] - start[:3, 3], [0, 0, LIFT_M], atol=0.003)
    assert tilt_deg(end) < 2.0
