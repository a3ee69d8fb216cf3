"""Plans two Pandas in two of ManiSkill's own tasks, with the planner and the checker of this suite alone.

    python examples/library/two_robots.py [--episodes 3]

Subgoals and constraints are sentences, the same for all scenes; only the poses of objects are read anew from
each. Success is ManiSkill's.
"""

import argparse
from dataclasses import dataclass
from typing import Any

import gymnasium
import mani_skill.envs  # noqa: F401  registers the environments

from rf_exp.library import Execution, InteractionPoint, JointLimits, NoPlan, Workcell, transform

LIMITS = JointLimits(
    velocity_rad_s=2.1, acceleration_rad_s2=7.5
)  # Franka's, for the slowest joints: docs/library.md
TURNS = "Agent_1 and Agent_2 may share the same space one after the other."


@dataclass(frozen=True)
class Job:
    """Subgoals and constraints for the scenes of an environment."""

    subgoals: dict[int, list[str]]
    constraints: list[str]
    points: dict[str, dict[str, InteractionPoint]]  # that cannot be derived from the shapes


JOBS = {
    "TwoRobotPickCube-v1": Job(
        {
            1: ["grasp cube at center", "place cube to handover"],
            2: ["aside", "grasp cube at center", "carry cube to goal_site at middle_of_cube"],
        },
        ["Agent_1 must place cube before Agent_2 grasps cube.", TURNS],
        # The origin of a cube is on its underside; its middle, 2 cm above, must be in the goal.
        {"goal_site": {"middle_of_cube": InteractionPoint(transform((0, 0, -0.02)), "place", turns=4)}},
    ),
    "TwoRobotStackCube-v1": Job(
        {
            1: ["grasp cubeA at center", "aside", "place cubeA to cubeB at top"],
            2: ["grasp cubeB at center", "place cubeB to goal_region at inside"],
        },
        [
            "Agent_1 must grasp cubeA before Agent_2 places cubeB.",  # cubeA may stand in the goal region
            "Agent_2 must place cubeB before Agent_1 places cubeA.",
            TURNS,
        ],
        # At the limit of the second arm's reach: up to 4 cm off the middle is accepted; the region has 6.
        {"goal_region": {"inside": InteractionPoint(transform(), "place", turns=12, slack_m=0.04)}},
    ),
}


def play(env: gymnasium.Env, seed: int, job: Job, limits: JointLimits = LIMITS) -> Execution | NoPlan:
    """Reads the scene of a seed, plans, and executes the plan."""
    env.reset(seed=seed)
    cell = Workcell(env, points=job.points, places={"handover": transform()}, limits=limits)
    try:
        return cell.execute(cell.plan(job.subgoals, job.constraints))
    except NoPlan as no_plan:
        return no_plan


def make(name: str) -> gymnasium.Env:
    """An environment with absolute joint targets and a step limit that suits slow arms."""
    options: dict[str, Any] = {"control_mode": "pd_joint_pos", "max_episode_steps": 400}
    return gymnasium.make(name, obs_mode="none", reward_mode="none", render_backend="none", **options)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=3)
    args = parser.parse_args()
    for name, job in JOBS.items():
        env = make(name)
        for seed in range(args.episodes):
            print(name, seed, play(env, seed, job))
        env.close()
