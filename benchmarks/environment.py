"""What a step of an environment costs beside the simulator's own, for every task, in one run.

    python benchmarks/environment.py [--tasks lift_barrier,place_food] [--repeats 5] [--pictures] [--overlaps]

The commands of an expert's episode go to a bare simulator, to the environment that `gymnasium.make` gives,
and to PettingZoo's: step by step in turn, so that a busy machine slows all three. The same commands are the
same work, so each step counts with the least time of all repeats. With `--pictures` all three take those of
every camera as well; with `--overlaps` the environments look for overlaps of arms, as evaluation does. A line
for each task; the last one is JSON: ratios of the environments to the simulator, of each task and the worst.
"""

import argparse
import json
import time
from collections.abc import Callable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.datagen.generate import make_episode
from rf_exp.datagen.planning import Settings
from rf_exp.envs import Observations, parallel_env
from rf_exp.envs.registration import configured, environment_id, find_task
from rf_exp.sim import Simulator
from rf_exp.types import Pictures, Row

SEED = 0
Step = Callable[[NDArray[np.float32]], object]


def expert(name: str) -> NDArray[np.float32]:
    """(T, N, 8) the commands of the expert in the scene of the seed."""
    settings = Settings(find_task(name), Row("full"), ScriptedSpec())
    episode = make_episode(settings, Pictures(render=False), SEED).episode
    assert episode is not None, f"the expert fails in {name}, seed {SEED}"
    return episode.commanded


def compared(name: str, repeats: int, pictures: bool, overlaps: bool) -> NDArray[np.float64]:
    """(3,) mean ms of a step: simulator, Gymnasium, PettingZoo."""
    commands, seen = expert(name), Observations(pictures=pictures)
    with Simulator(find_task(name), render=pictures) as world:
        options = {"observations": seen, "overlaps": overlaps}
        single = gymnasium.make(environment_id(name), **options)
        several = parallel_env(name, **options)

        def bare(command: NDArray[np.float32]) -> None:
            world.step(command.astype(float))
            if pictures:
                world.pictures()

        def each(command: NDArray[np.float32]) -> None:
            several.step(dict(zip(several.agents, command, strict=True)))

        steps: list[Step] = [bare, single.step, each]
        times_ms = np.full((3, repeats, len(commands)), np.inf)
        for repeat in range(repeats):
            world.reset(SEED)
            single.reset(seed=SEED)
            several.reset(seed=SEED)
            for k, command in enumerate(commands):
                for turn in range(3):  # everybody is first in turn
                    who = (k + repeat + turn) % 3
                    began = time.perf_counter()
                    steps[who](command)
                    times_ms[who, repeat, k] = 1e3 * (time.perf_counter() - began)
        assert several.core.success, f"{name}: played again, the episode does not succeed"
        single.close()
        several.close()
    return times_ms.min(axis=1).mean(axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default=",".join(configured()))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--overlaps", action="store_true")
    given = parser.parse_args()
    ratios: dict[str, dict[str, float]] = {"gymnasium": {}, "pettingzoo": {}}
    for name in given.tasks.split(","):
        bare_ms, single_ms, several_ms = compared(name, given.repeats, given.pictures, given.overlaps)
        ratios["gymnasium"][name] = round(single_ms / bare_ms, 3)
        ratios["pettingzoo"][name] = round(several_ms / bare_ms, 3)
        said = f"simulator {bare_ms:.2f} ms, Gymnasium {single_ms:.2f} ms, PettingZoo {several_ms:.2f} ms"
        print(f"{name}: {said}", flush=True)
    worst = {f"{face}_worst": max(of.values()) for face, of in ratios.items()}
    print(json.dumps({"benchmark": "environment", **worst, **ratios}))


if __name__ == "__main__":
    main()
