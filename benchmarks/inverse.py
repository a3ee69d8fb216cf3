"""Cost of inverse kinematics: the closed form of each robot against the Newton steps for any arm.

    python benchmarks/inverse.py [--poses 100]

Poses are drawn about the rest posture. Timed are calls for one pose each, and one call for all, which costs
less per pose. Robots whose packages are not installed are left out. The last line is JSON: CPU ms of both.
"""

import argparse
import json
import time

import numpy as np

from rf_exp.errors import StageError
from rf_exp.robots import Inverse, Robot, known_robots
from rf_exp.robots.kinematics import Numeric


def cost_ms(solver: Inverse, robot: Robot, joints: np.ndarray) -> tuple[float, float]:
    """CPU ms of a call for one pose, and per pose of a call for all."""
    poses, last, limits = robot.tcp_pose(joints), joints[:, -1], robot.limits_rad
    solver.postures(poses[0], last[0], limits)
    began = time.process_time()
    for pose, last_rad in zip(poses, last, strict=True):
        solver.postures(pose, last_rad, limits)
    single_s = time.process_time() - began
    solver.postures(poses, last, limits)
    batch_s = time.process_time() - began - single_s
    return round(1e3 * single_s / len(joints), 4), round(1e3 * batch_s / len(joints), 4)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=100)
    poses = parser.parse_args().poses
    results = {}
    for robot in known_robots():
        try:
            rest = np.array(robot.rest_rad)
            joints = rest + np.random.default_rng(0).uniform(-0.5, 0.5, (poses, robot.dof))
            solvers = {"closed": robot.solver, "numeric": Numeric(robot)}
        except StageError as error:
            print(f"{robot.name}: {error}")
            continue
        for name, solver in solvers.items():
            call_ms, batch_ms = cost_ms(solver, robot, joints)
            results.setdefault(robot.name, {})[name] = {"call_ms": call_ms, "of_many_ms": batch_ms}
            print(f"{robot.name}, {name}: {call_ms:.2f} ms a call, {batch_ms:.4f} ms a pose of {poses}")
    print(json.dumps(results))


if __name__ == "__main__":
    main()
