"""Two Pandas of stock ManiSkill pass through one another's hands; with own collision ids they do not.

    python benchmarks/stock_collisions.py

Needs `mani-skill` and nothing of this project. In `TwoRobotPickCube-v1` two Pandas stand face to face. The
second one is moved up, base and all, until the middles of the two hands are 30 mm apart: 35 mm deep in one
another, the fingers beside one another. Then both are told to stay where they are, for two seconds.

Links that the SRDF excuses from colliding within an arm (hand with link 5, 6, 7, ...) share a bit in word 2
of their collision groups. PhysX ignores two shapes with a common bit in word 2 and equal numbers in word 3,
and SAPIEN leaves word 3 at 0 for every articulation: so what is excused within an arm is excused between
arms, and every such link with itself.

The last line is JSON: how far apart the hands are in the end and in how many physics steps PhysX reported a
contact of the two, as it is and with word 3 set to the number of the robot.
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
    """(distance of the two hands in the end in mm, physics steps with a contact between them)."""
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
    apart_mm = 1000 * float(np.linalg.norm(hands[1].entity_pose.p - hands[0].entity_pose.p))
    env.close()
    return round(apart_mm, 1), touching


def main() -> None:
    logging.disable(logging.WARNING)
    stock, separate = pushed_apart(own_ids=False), pushed_apart(own_ids=True)
    for name, (apart_mm, touching) in (("as it is", stock), ("own ids", separate)):
        print(
            f"{name}: the hands are {apart_mm} mm apart in the end, {touching} steps with a contact of them"
        )
    result = {
        "stock_mm": stock[0],
        "stock_contacts": stock[1],
        "own_ids_mm": separate[0],
        "own_ids_contacts": separate[1],
    }
    print(json.dumps({"benchmark": "stock_collisions", **result}))


if __name__ == "__main__":
    main()
