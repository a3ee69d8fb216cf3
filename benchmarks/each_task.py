"""Command line of benchmarks that measure each task: `--tasks`, `--seeds`, a line per task, then JSON."""

import argparse
import json
from collections.abc import Callable

from rf_exp.errors import choices
from rf_exp.tasks import CONFIGURED, Task, read_task


def measure_each(
    parser: argparse.ArgumentParser, measured: Callable[[Task, int], dict[str, float]], seeds: int
) -> None:
    """Print the results of `measured(task, seeds)`, a line per task; the last line is all of them as JSON."""
    paths = {path.stem: path for path in sorted(CONFIGURED.glob("*.yaml")) if path.stem != "all"}
    parser.add_argument("--tasks", default=",".join(paths), help="comma-separated names; default: all")
    parser.add_argument("--seeds", type=int, default=seeds)
    given = parser.parse_args()
    for name in (names := given.tasks.split(",")):
        if name not in paths:
            parser.error(str(choices("task", name, paths)))
    found = {}
    for name in names:
        found[name] = measured(read_task(paths[name]), given.seeds)
        print(f"{name:26s} " + "  ".join(f"{key} {value}" for key, value in found[name].items()), flush=True)
    print(json.dumps(found))
