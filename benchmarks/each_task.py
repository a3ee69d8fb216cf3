"""Command line of benchmarks that measure each task: `--tasks`, `--seeds`, a line per task, then JSON."""

import argparse
import json
from collections.abc import Callable

from rf_exp.errors import unknown_choice
from rf_exp.tasks import CONFIGURED, Task, read_task


def measure_each(
    parser: argparse.ArgumentParser, measure: Callable[[Task, int], dict[str, float]], seeds: int
) -> None:
    """Print the results of `measured(task, seeds)`, a line per task; the last line is all of them as JSON."""
    paths = {path.stem: path for path in sorted(CONFIGURED.glob("*.yaml")) if path.stem != "all"}
    parser.add_argument("--tasks", default=",".join(paths), help="comma-separated names; default: all")
    parser.add_argument("--seeds", type=int, default=seeds)
    args = parser.parse_args()
    for name in (names := args.tasks.split(",")):
        if name not in paths:
            parser.error(str(unknown_choice("task", name, paths)))
    results = {}
    for name in names:
        results[name] = measure(read_task(paths[name]), args.seeds)
        print(
            f"{name:26s} " + "  ".join(f"{key} {value}" for key, value in results[name].items()), flush=True
        )
    print(json.dumps(results))
