"""Whether stored actions, played again from the stored seeds, give the stored episodes again, untouched.

    python benchmarks/replay.py outputs/data [--episodes 50] [--workers 2]

Plays every episode of every store below a folder, or the first ones of each, without pictures, and
judges it by the strict criterion. The last line is JSON: episodes, successes, how many gave the stored
joint positions to the last bit, and in how many one arm touched another: by contact force, or by the
exact overlap of links, fingers and loads; a gripper may meet what another one holds.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from rf_exp.constraints import PolicyMonitor
from rf_exp.sim.pool import in_order, simulator
from rf_exp.store import Store
from rf_exp.tasks import Judge, Task
from rf_exp.tasks.configuration import load_task
from rf_exp.types import Pictures


def replay(
    task: Task, seed: int, qpos: NDArray[np.float32], action: NDArray[np.float32]
) -> tuple[bool, bool, bool]:
    """(success, same joints, arms touched) of an episode with states (T, N, 9) and actions (T, N, 8)."""
    world = simulator(task, Pictures(render=False))
    scene = world.reset(seed)
    judge, monitor, same, touched = Judge(task, scene), PolicyMonitor(task), True, False
    verdict = judge(scene)
    for row, command in zip(qpos, action.astype(float), strict=True):
        same &= bool(np.array_equal(row, scene.qpos.astype(np.float32)))
        scene = world.step(command)
        verdict = judge(scene)
        touched |= monitor(scene) is not None
    return verdict.success, same, touched


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("outputs/data"))
    parser.add_argument("--episodes", type=int, help="of each store; all unless given")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    total = np.zeros(4, dtype=int)
    for path in sorted(given.folder.glob("**/*.zarr")):
        with Store.open(path) as store:
            task = load_task(store.identity["task"], store.identity["scene"])
            episodes = [store.episode(k) for k in range(len(store))[: given.episodes]]
        jobs = (delayed(replay)(task, each.seed, each.qpos, each.action) for each in episodes)
        results = list(in_order(jobs, given.workers))
        counts = [len(results), *np.sum(results, axis=0).tolist()] if results else [0, 0, 0, 0]
        print(
            f"{path}: {counts[1]} of {counts[0]} succeed again, {counts[2]} to the last bit, arms touch in "
            f"{counts[3]}",
            flush=True,
        )
        total += counts
    result = dict(zip(("episodes", "successes", "identical", "touched"), total.tolist(), strict=True))
    print(json.dumps({"benchmark": "replay", **result}))


if __name__ == "__main__":
    main()
