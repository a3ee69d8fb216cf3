"""Random agents, one per arm: how to use the PettingZoo environment.

    python examples/random_agent.py [--task lift_barrier] [--episodes 3] [--steps 100]

Absolute joint targets sampled from the whole action space would throw the arms about; these follow a random
walk.
"""

import argparse

import numpy as np

from rf_exp.envs import Observations, parallel_env

STRIDE = np.array([0.03] * 7 + [0.2], np.float32)  # rad, gripper: standard deviation of a step


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--task", default="lift_barrier")
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--steps", type=int, help="control steps of an episode; the task's own unless given")
    args = parser.parse_args()
    env = parallel_env(args.task, Observations(state="joints"), step_limit=args.steps)
    rng = np.random.default_rng(0)
    for episode in range(args.episodes):
        observations, infos = env.reset(seed=episode)
        actions = {agent: np.append(observations[agent]["qpos"][:7], 1.0) for agent in env.agents}
        total = 0.0
        while env.agents:
            for agent in env.agents:
                space = env.action_space(agent)
                actions[agent] = np.clip(
                    actions[agent] + STRIDE * rng.standard_normal(8), space.low, space.high
                )
            observations, rewards, _terminated, _truncated, infos = env.step(actions)
            total += rewards["agent1"]
        info = infos["agent1"]
        missing = [name for name, holds in info["conditions"].items() if not holds]
        print(f"scene {info['seed']}: reward {total:g}, {info['violations']} violations, not {missing}")
    env.close()


if __name__ == "__main__":
    main()
