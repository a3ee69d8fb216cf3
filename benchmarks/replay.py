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

from rf_exp.constraints import overlapping, pressing
from rf_exp.geometry import Separation
from rf_exp.processes import in_order
from rf_exp.sim import shared_simulator
from rf_exp.store import Store
from rf_exp.tasks import CONFIGURED, SuccessEvaluator, Task, stored_task
from rf_exp.types import NO_PICTURES


class Played(NamedTuple):
    """Result of one replayed episode."""

    success: bool
    same: bool  # joint positions equal to the last bit
    pressed: bool
    overlapped: bool
    depth_mm: float  # the deepest overlap


def replay(task: Task, seed: int, qpos: NDArray[np.float32], action: NDArray[np.float32]) -> Played:
    """Replays an episode with states (T, N, 9) and actions (T, N, 8)."""
    world = shared_simulator(task, NO_PICTURES)
    pairs, things = tuple(combinations(task.agents, 2)), frozenset(task.objects)
    separation = Separation(task)
    scene = world.reset(seed)
    judge, same, pressed, depth_m = SuccessEvaluator(task, scene), True, False, 0.0
    verdict = judge(scene)
    for row, command in zip(qpos, action.astype(float), strict=True):
        same &= bool(np.array_equal(row, scene.qpos.astype(np.float32)))
        scene = world.step(command)
        verdict = judge(scene)
        pressed |= pressing(scene, pairs) is not None
        found = overlapping(separation, scene, pairs, lambda agent: things)
        depth_m = max(depth_m, 0.0 if found is None else -found.value)
    return Played(verdict.success, same, pressed, depth_m > 0, 1000 * depth_m)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("outputs/data"))
    parser.add_argument("--episodes", type=int, help="of each store; all unless given")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--tasks", type=Path, default=CONFIGURED, help="folder of the tasks' YAML files")
    given = parser.parse_args()
    total: list[Played] = []
    for path in sorted(given.folder.glob("**/*.zarr")):
        with Store.open(path) as store:
            task = stored_task(store.identity, given.tasks)
            episodes = [store.episode(k) for k in range(len(store))[: given.episodes]]
        jobs = (partial(replay, task, each.seed, each.qpos, each.commanded) for each in episodes)
        results = list(in_order(jobs, given.workers))
        total += results
        print(f"{path}: {_said(results)}", flush=True)
    deepest = round(max((each.depth_mm for each in total), default=0.0), 2)
    counts = {name: sum(each) for name, each in _columns(total).items()}
    result = {"episodes": len(total), **counts, "depth_mm": deepest}
    print(json.dumps({"benchmark": "replay", **result}))


def _columns(played: list[Played]) -> dict[str, list[bool]]:
    return {name: [getattr(each, name) for each in played] for name in Played._fields[:-1]}


def _said(played: list[Played]) -> str:
    counts = {name: sum(each) for name, each in _columns(played).items()}
    deepest = max((each.depth_mm for each in played), default=0.0)
    return (
        f"{counts['success']} of {len(played)} succeed again, {counts['same']} to the last bit; arms press "
        f"in {counts['pressed']}, overlap in {counts['overlapped']}, by {deepest:.1f} mm at most"
    )


if __name__ == "__main__":
    main()
