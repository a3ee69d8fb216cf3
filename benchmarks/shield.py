"""Effect and cost of the shield: demonstrations played back with and without it, each arm with its own delay.

    python benchmarks/shield.py outputs/data [--episodes 5] [--late 60] [--chunk 16] [--workers 2]

Each agent plays its demonstrated commands in chunks, regardless of the others, and starts up to `--late`
control steps late, drawn from the seed, like separate policies that have learnt every motion and no
coordination. With `--late 0` it is the demonstration itself, in which a shield should not intervene. Every
episode runs without and with the shield, in the same scene, without pictures. One line per store; the last
line is JSON: episodes, successes, control steps with a violation and with contact, interventions, without and
with; times of a control step of a rollout in ms, without and with, and of the shield alone; and their ratio.
"""

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import PolicyMonitor
from rf_exp.observations import Observation
from rf_exp.policy import Decision, PolicyRunner, Shield, Stream, View, rollout
from rf_exp.processes import Timeout, in_order
from rf_exp.sim import shared_simulator
from rf_exp.store import Store
from rf_exp.tasks import CONFIGURED, SuccessEvaluator, Task, stored_task
from rf_exp.types import NO_PICTURES, Episode, Rollout, Scene

FASTEST_RAD = 0.05  # per control step; demonstrations are slower
SLOWER = 2  # step limit of a rollout, relative to the demonstration


class Player(PolicyRunner):
    """Policy of one agent that plays back commands (T, 8) in chunks, and holds still before and after."""

    def __init__(self, agent: int, commands: NDArray[np.float64], chunk: int, late: int) -> None:
        self._commands, self._chunk, self._late, self._done = commands, chunk, late, -late
        super().__init__(View(f"agent{agent}", (Stream(f"agent{agent}", (agent,)),)), np.array([FASTEST_RAD]))

    def reset(self, seed: int) -> None:
        super().reset(seed)
        self._done = -self._late

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        indices = np.clip(self._done + np.arange(self._chunk), 0, len(self._commands) - 1)
        return self._commands[indices][:, None]

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        if decision is None or self.view.agents[0] not in decision.withheld:
            self._done += 1
        return super().act(decision)


@dataclass
class Timed:
    """Shield that records its run times."""

    shield: Shield
    times_s: list[float]

    def __call__(self, scene: Scene, ahead: Mapping[int, NDArray[np.float64]]) -> Decision:
        began = time.perf_counter()
        decision = self.shield(scene, ahead)
        self.times_s.append(time.perf_counter() - began)
        return decision


ShieldComparison = dict[bool, tuple[Rollout, float]]  # with a shield or not -> rollout, its wall time in s


def play(task: Task, episode: Episode, chunk: int, late: int) -> tuple[ShieldComparison, list[float]]:
    """Rollouts without and with a shield, and the time of the shield in s at each control step."""
    rng = np.random.default_rng([episode.seed, late])
    delays = rng.integers(0, late + 1, len(task.agents)).tolist()
    commands = episode.commanded.astype(float)
    times_s: list[float] = []
    rollouts: ShieldComparison = {}
    for shielded in (False, True):
        world = shared_simulator(task, NO_PICTURES)
        start = world.reset(episode.seed)
        runners = [
            Player(agent, commands[:, agent - 1], chunk, delay)
            for agent, delay in zip(task.agents, delays, strict=True)
        ]
        shield = Timed(Shield(task), times_s) if shielded else None
        limit, judge, monitor = SLOWER * len(commands), SuccessEvaluator(task, start), PolicyMonitor(task)
        began = time.perf_counter()
        result = rollout(world, judge, runners, episode.seed, limit, monitor, None, start, shield)
        rollouts[shielded] = result, time.perf_counter() - began
    return rollouts, times_s


def summary(played: list[tuple[ShieldComparison, list[float]]]) -> dict[str, float]:
    """Counts and times over all rollouts."""
    result: dict[str, float] = {"episodes": len(played)}
    step_ms = {}
    for shielded, name in ((False, "without"), (True, "with")):
        results = [comparison[shielded][0] for comparison, _ in played]
        result |= {
            f"success_{name}": sum(outcome.success for outcome in results),
            f"violations_{name}": sum(outcome.violations for outcome in results),
            f"contacts_{name}": sum(outcome.contacts for outcome in results),
        }
        steps = sum(outcome.steps for outcome in results)
        step_ms[name] = 1e3 * sum(comparison[shielded][1] for comparison, _ in played) / steps
        result[f"steps_{name}"] = steps
    times_ms = 1e3 * np.array([time_s for _, times_s in played for time_s in times_s])
    return result | {
        "interventions": sum(comparison[True][0].interventions for comparison, _ in played),
        "step_ms_without": round(step_ms["without"], 2),
        "step_ms_with": round(step_ms["with"], 2),
        "shield_ms": round(fmean(times_ms), 2),
        "shield_ms_median": round(float(np.median(times_ms)), 2),
        "shield_ms_99": round(float(np.quantile(times_ms, 0.99)), 2),
        "with_over_without": round(step_ms["with"] / step_ms["without"], 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("outputs/data"))
    parser.add_argument("--episodes", type=int, default=5, help="of each store")
    parser.add_argument("--late", type=int, default=60, help="control steps at most")
    parser.add_argument("--chunk", type=int, default=16, help="control steps")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--tasks", type=Path, default=CONFIGURED, help="folder of the tasks' YAML files")
    args = parser.parse_args()
    total = []
    for path in sorted(args.folder.glob("**/*.zarr")):
        with Store.open(path) as store:
            task = stored_task(store.identity, args.tasks)
            episodes = [store.episode(k) for k in range(len(store))[: args.episodes]]
        jobs = [partial(play, task, episode, args.chunk, args.late) for episode in episodes]
        played = [result for result in in_order(jobs, args.workers) if not isinstance(result, Timeout)]
        total += played
        print(f"{path}: {json.dumps(summary(played))}", flush=True)
    print(json.dumps(summary(total)))


if __name__ == "__main__":
    main()
