"""Cost of an environment step relative to the simulator's own, for every task, in one run.

    python benchmarks/environment.py [--tasks lift_barrier,place_food] [--repeats 5] [--pictures] [--overlaps]

The commands of an expert's episode go to the environment of `gymnasium.make` and to PettingZoo's, alternating
step by step. The simulator is timed separately within each step; the rest is success evaluation, observation
and overhead. The same commands are the same work, so each step counts with its minimum over all repeats. With
`--pictures` all cameras take pictures, and rendering counts as simulator time; with `--overlaps` the
environments test arms for overlaps, as evaluation does. One line per task; the last line is JSON: the ratio
of a step to the simulator's own time, for each task and the worst.
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen import Settings, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs import Observations, environment_id, parallel_env
from rf_exp.envs.core import find_task, task_names
from rf_exp.sim import Simulator
from rf_exp.types import NO_PICTURES, ConstraintSet

SEED = 0
INTERFACES = ("gymnasium", "pettingzoo")


class Clock:
    """Stopwatch for the time spent in the simulator."""

    def __init__(self) -> None:
        self.ms = 0.0

    def on(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, timed by this clock."""

        def timed(*arguments: Any) -> Any:
            began = time.perf_counter()
            result = work(*arguments)
            self.ms += 1e3 * (time.perf_counter() - began)
            return result

        return timed


def expert(name: str) -> NDArray[np.float32]:
    """The expert's commands (T, N, 8) in the scene of the seed."""
    settings = Settings.configured(find_task(name), ConstraintSet("full"), ScriptedSpec())
    episode = make_episode(settings, NO_PICTURES, SEED).episode
    assert episode is not None, f"the expert fails in {name}, seed {SEED}"
    return episode.commanded


def steps_ms(name: str, clock: Clock, repeats: int, options: dict[str, Any]) -> NDArray[np.float64]:
    """Mean ms (faces, 2) of a step: in the simulator, and in the rest."""
    commands = expert(name)
    single, parallel = gymnasium.make(environment_id(name), **options), parallel_env(name, **options)
    agents = parallel.possible_agents
    agent_commands = [dict(zip(agents, command, strict=True)) for command in commands]
    times_ms = np.empty((len(INTERFACES), 2, repeats, len(commands)))
    for repeat in range(repeats):
        single.reset(seed=SEED)
        parallel.reset(seed=SEED)
        for k, commands_of_step in enumerate(zip(commands, agent_commands, strict=True)):
            for interface, environment in enumerate((single, parallel)):
                clock.ms, began = 0.0, time.perf_counter()
                environment.step(commands_of_step[interface])
                rest_ms = 1e3 * (time.perf_counter() - began) - clock.ms
                times_ms[interface, :, repeat, k] = clock.ms, rest_ms
        assert parallel.core.episode.success, f"{name}: played again, the episode does not succeed"
    single.close()
    parallel.close()
    return times_ms.min(axis=2).mean(axis=2)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default=",".join(task_names()))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--overlaps", action="store_true")
    args = parser.parse_args()
    clock = Clock()
    Simulator.step = clock.on(Simulator.step)  # before any environment is made
    Simulator.images = clock.on(Simulator.images)
    options = {"observations": Observations(pictures=args.pictures), "overlaps": args.overlaps}
    ratios: dict[str, dict[str, float]] = {interface: {} for interface in INTERFACES}
    for name in args.tasks.split(","):
        texts = []
        for interface, (own_ms, rest_ms) in zip(
            INTERFACES, steps_ms(name, clock, args.repeats, options), strict=True
        ):
            ratios[interface][name] = round(1 + rest_ms / own_ms, 3)
            texts.append(f"{interface} {own_ms:.2f} ms and {rest_ms:.3f} ms, {ratios[interface][name]:.3f}")
        print(f"{name}: {'; '.join(texts)}", flush=True)
    worst = {f"{interface}_worst": max(ratio_by_task.values()) for interface, ratio_by_task in ratios.items()}
    print(json.dumps({"benchmark": "environment", **worst, **ratios}))


if __name__ == "__main__":
    main()
