"""Replays stored actions from the stored seeds: do they reproduce the stored episodes, without contacts?

    python benchmarks/replay.py outputs/data [--episodes 50] [--workers 2]

Plays every episode of every store below a folder, or the first ones of each, without pictures, and
judges it by the strict criterion. Contact between arms is tested at every control step in two independent
ways: by force, from the simulator, and by geometry, as exact overlap of links, fingers and loads (a gripper
may touch an object held by another). The last line is JSON: numbers of episodes, of successes, of those with
the stored joint positions to the last bit, of those with contact forces between arms and of those with
overlaps, and the deepest overlap.
"""

import argparse
import json
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import force_evidence, overlap_evidence
from rf_exp.geometry import Separation
from rf_exp.processes import in_order
from rf_exp.sim import shared_simulator
from rf_exp.store import Store
from rf_exp.tasks import CONFIGURED, SuccessEvaluator, Task, stored_task
from rf_exp.types import NO_PICTURES


class ReplayResult(NamedTuple):
    """Result of one replayed episode."""

    success: bool
    same: bool  # joint positions equal to the last bit
    pressed: bool
    overlapped: bool
    depth_mm: float  # the deepest overlap


def replay(task: Task, seed: int, qpos: NDArray[np.float32], action: NDArray[np.float32]) -> ReplayResult:
    """Replays an episode with states (T, N, 9) and actions (T, N, 8)."""
    world = shared_simulator(task, NO_PICTURES)
    pairs, objects = tuple(combinations(task.agents, 2)), frozenset(task.objects)
    separation = Separation(task)
    scene = world.reset(seed)
    judge, same, pressed, depth_m = SuccessEvaluator(task, scene), True, False, 0.0
    verdict = judge(scene)
    for row, command in zip(qpos, action.astype(float), strict=True):
        same &= bool(np.array_equal(row, scene.qpos.astype(np.float32)))
        scene = world.step(command)
        verdict = judge(scene)
        pressed |= force_evidence(scene, pairs) is not None
        deepest = overlap_evidence(separation, scene, pairs, lambda agent: objects)
        depth_m = max(depth_m, 0.0 if deepest is None else -deepest.value)
    return ReplayResult(verdict.success, same, pressed, depth_m > 0, 1000 * depth_m)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("outputs/data"))
    parser.add_argument("--episodes", type=int, help="of each store; all unless given")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--tasks", type=Path, default=CONFIGURED, help="folder of the tasks' YAML files")
    args = parser.parse_args()
    total: list[ReplayResult] = []
    for path in sorted(args.folder.glob("**/*.zarr")):
        with Store.open(path) as store:
            task = stored_task(store.identity, args.tasks)
            episodes = [store.episode(k) for k in range(len(store))[: args.episodes]]
        jobs = (partial(replay, task, episode.seed, episode.qpos, episode.commanded) for episode in episodes)
        results = list(in_order(jobs, args.workers))
        total += results
        print(f"{path}: {_summary(results)}", flush=True)
    deepest = round(max((result.depth_mm for result in total), default=0.0), 2)
    counts = {name: sum(column) for name, column in _columns(total).items()}
    result = {"episodes": len(total), **counts, "depth_mm": deepest}
    print(json.dumps({"benchmark": "replay", **result}))


def _columns(played: list[ReplayResult]) -> dict[str, list[bool]]:
    return {name: [getattr(result, name) for result in played] for name in ReplayResult._fields[:-1]}


def _summary(played: list[ReplayResult]) -> str:
    counts = {name: sum(column) for name, column in _columns(played).items()}
    deepest = max((result.depth_mm for result in played), default=0.0)
    return (
        f"{counts['success']} of {len(played)} succeed again, {counts['same']} to the last bit; arms press "
        f"in {counts['pressed']}, overlap in {counts['overlapped']}, by {deepest:.1f} mm at most"
    )


if __name__ == "__main__":
    main()
