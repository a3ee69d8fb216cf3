"""Occupancy from depth cameras in initial scenes: recall and precision against the poses of the objects.

    python benchmarks/depth.py [--task all] [--seeds 5]

Shares of voxels, one line of JSON per task and one for all. Of the voxels that objects fill, `seen` are
observed, and `seen_or_below` are observed or assumed to be filled, being below observed ones. `there` of the
observed voxels are filled by objects, and `there_below` of those observed or below. Needs Vulkan.
"""

import argparse
import json

from rf_exp.command import CONF
from rf_exp.geometry import PlanningScene, shared, voxels
from rf_exp.perception import down_to_table, occupied_voxels
from rf_exp.sim import Simulator
from rf_exp.tasks import read_task

TASKS = sorted(path.stem for path in (CONF / "task").glob("*.yaml") if path.stem != "all")


def count_voxels(name: str, seeds: int) -> dict[str, int]:
    """Numbers of voxels: filled by objects; observed; observed or below; the filled ones of the last two."""
    counts: dict[str, int] = dict.fromkeys(("filled", "seen", "below", "seen_filled", "below_filled"), 0)
    with Simulator(read_task(CONF / "task" / f"{name}.yaml"), width_px=320, height_px=240) as world:
        for seed in range(seeds):
            planning_scene = PlanningScene(world.task, world.reset(seed))
            filled = voxels(planning_scene.static_objects(list(world.task.objects)))
            observed = occupied_voxels(world.depth(), world.camera_models(), planning_scene)
            below = down_to_table(observed)
            counts["filled"] += len(filled)
            counts["seen"] += len(observed)
            counts["below"] += len(below)
            counts["seen_filled"] += len(shared(observed, filled))
            counts["below_filled"] += len(shared(below, filled))
    return counts


def shares(counts: dict[str, int]) -> dict[str, float]:
    return {
        "seen": round(counts["seen_filled"] / counts["filled"], 3),
        "seen_or_below": round(counts["below_filled"] / counts["filled"], 3),
        "there": round(counts["seen_filled"] / counts["seen"], 3),
        "there_below": round(counts["below_filled"] / counts["below"], 3),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--task", default="all", choices=["all", *TASKS])
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    total: dict[str, int] = {}
    for task in TASKS if args.task == "all" else [args.task]:
        counts = count_voxels(task, args.seeds)
        total = {key: total.get(key, 0) + count for key, count in counts.items()}
        print(json.dumps({"task": task, **shares(counts)}), flush=True)
    print(json.dumps({"task": "all", **shares(total)}))
