"""Replays episodes of the expert in the Gymnasium environment, command by command.

    python examples/expert.py [--task lift_barrier] [--episodes 3]

The same seed gives the same scene, and the same commands give the same episode, so each replay succeeds as
the expert's episode did.
"""

import argparse

import gymnasium

import rf_exp.envs  # registers the tasks
from rf_exp.datagen import Settings, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.types import NO_PICTURES, ConstraintSet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--task", default="lift_barrier")
    parser.add_argument("--episodes", type=int, default=3)
    args = parser.parse_args()
    env = gymnasium.make(rf_exp.envs.environment_id(args.task))
    settings = Settings.configured(env.get_wrapper_attr("task"), ConstraintSet("full"), ScriptedSpec())
    for seed in range(args.episodes):
        episode = make_episode(settings, NO_PICTURES, seed).episode
        if episode is None:
            print(f"scene {seed}: the expert does not succeed")
            continue
        _, info = env.reset(seed=seed)
        for command in episode.commanded:  # (N, 8)
            _, reward, terminated, _, info = env.step(command)
        print(
            f"scene {seed}: {len(episode.commanded)} steps, reward {reward}, terminated {terminated}, {info}"
        )
    env.close()


if __name__ == "__main__":
    main()
