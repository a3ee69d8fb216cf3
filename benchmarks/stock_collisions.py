"""Grippers of two Pandas in stock ManiSkill pass through one another; with collision ids per arm they do not.

    python benchmarks/stock_collisions.py

Needs only `mani-skill`, nothing of this project. In `TwoRobotPickCube-v1` two Pandas stand face to face. The
second one is moved, with its base, until the centres of the two hand links are 30 mm apart: 35 mm deep in one
another, the fingers side by side. Then both hold their joints for two seconds.

Links that the SRDF excuses from colliding within an arm (hand with link 5, 6, 7, ...) share a bit in word 2
of their collision groups. PhysX ignores two shapes with a common bit in word 2 and equal numbers in word 3,
and SAPIEN leaves word 3 at 0 for every articulation. Pairs that are excused within an arm are therefore also
excused between arms, and so is every such link with its counterpart.

The last line is JSON: the final distance of the hand links and the number of physics steps with a contact of
the two, unchanged and with word 3 set to the number of the robot.
"""

import json
import logging
from typing import Any

import gymnasium
import mani_skill.envs  # noqa: F401  registers the environments
import numpy as np
import sapien

SECONDS, APART_M = 2.0, 0.03


def pushed_apart(*, own_ids: bool) -> tuple[float, int]:
    """(final distance of the two hand links in mm, physics steps with a contact between them)."""
    env = gymnasium.make("TwoRobotPickCube-v1", obs_mode="none", render_backend="none")
    env.reset(seed=0)
    base: Any = env.unwrapped
    robots = [agent.robot._objs[0] for agent in base.agent.agents]
    for number, robot in enumerate(robots, start=1):
        for link in robot.links:
            for shape in link.collision_shapes if own_ids else ():
                shape.set_collision_groups([*shape.get_collision_groups()[:3], number])
        for joint, value in zip(robot.active_joints, robot.qpos, strict=True):
            joint.set_drive_target(value)
    hands = [next(link for link in robot.links if link.name.endswith("panda_hand")) for robot in robots]
    between = hands[1].entity_pose.p - hands[0].entity_pose.p
    shift = APART_M * between / np.linalg.norm(between) - between
    robots[1].set_root_pose(sapien.Pose(robots[1].root_pose.p + shift, robots[1].root_pose.q))
    physics, touching = base.scene.px, 0
    for _ in range(int(SECONDS / physics.timestep)):
        physics.step()
        touching += any(set(contact.bodies) == set(hands) for contact in physics.get_contacts())
    gap_mm = 1000 * float(np.linalg.norm(hands[1].entity_pose.p - hands[0].entity_pose.p))
    env.close()
    return round(gap_mm, 1), touching


def main() -> None:
    logging.disable(logging.WARNING)
    stock, separate = pushed_apart(own_ids=False), pushed_apart(own_ids=True)
    for name, (gap_mm, touching) in (("as it is", stock), ("own ids", separate)):
        print(f"{name}: the hands are {gap_mm} mm apart in the end, {touching} steps with a contact of them")
    result = {
        "stock_mm": stock[0],
        "stock_contacts": stock[1],
        "own_ids_mm": separate[0],
        "own_ids_contacts": separate[1],
    }
    print(json.dumps({"benchmark": "stock_collisions", **result}))


if __name__ == "__main__":
    main()
