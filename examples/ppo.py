"""A short PPO training with stable-baselines3, with one controller for all arms.

    pip install stable-baselines3    # in an environment that has rf_exp
    python examples/ppo.py [--task pick_meat] [--steps 4096] [--envs 2]

It shows how the parts fit together. The reward is sparse: minutes of PPO from scratch do not reach it.
"""

import argparse

import gymnasium
import numpy as np

import rf_exp.envs  # registers the tasks

try:
    from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]
    from stable_baselines3.common.env_util import make_vec_env  # pyright: ignore[reportMissingImports]
    from stable_baselines3.common.evaluation import evaluate_policy  # pyright: ignore[reportMissingImports]
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; run: pip install stable-baselines3") from None


def rescale_actions(env: gymnasium.Env) -> gymnasium.Env:
    """Rescales actions in [-1, 1], where PPO starts, to the range of every joint."""
    return gymnasium.wrappers.RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--task", default="pick_meat")
    parser.add_argument("--steps", type=int, default=4096)
    parser.add_argument("--envs", type=int, default=2)
    args = parser.parse_args()
    name = rf_exp.envs.environment_id(args.task)
    env = make_vec_env(name, args.envs, seed=0, wrapper_class=rescale_actions)
    model = PPO("MultiInputPolicy", env, n_steps=min(256, args.steps // args.envs), seed=0, verbose=1)
    model.learn(args.steps)
    reward, _ = evaluate_policy(model, env, n_eval_episodes=4)
    print(f"{args.task}: mean reward {reward:g} after {model.num_timesteps} control steps")
    env.close()


if __name__ == "__main__":
    main()
