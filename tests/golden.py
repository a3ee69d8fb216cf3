"""Digests of the first episode of every task under every row of constraints, kept in golden.json.

    python -m tests.golden                    takes them anew, about a minute of one core
    python -m tests.golden lift_barrier       of these tasks only

Bytes were taken on one kind of processor. On another they may differ in their last bit, for all that `rf_exp`
chooses the same kernels for them; where they do, plans and how each step is judged have to be as recorded.

They force a version to be raised where bytes change, so that old and new demonstrations never share a
store: digests that changed under the same versions are not taken. Until data of a version is with
anybody, `--same-versions` takes them all the same.
"""

import argparse
import json
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.artifacts import digest, write_json
from rf_exp.datagen import GENERATOR, EpisodeGenerator, NullObserver, Settings
from rf_exp.datagen.brain import ScriptedSpec, to_json
from rf_exp.sim import Simulator
from rf_exp.tasks import SuccessEvaluator, Task
from rf_exp.types import CONTROL_HZ, ConstraintSet, Scene
from tests.conftest import CONF, TASKS, read_task
from tests.scenes import start_scene

FILE = Path(__file__).with_name("golden.json")
SEED = 0
PLANS = range(8)  # seeds whose first proposals are kept
Digests = dict[str, Any]


def rows() -> list[ConstraintSet]:
    paths = sorted(path for path in (CONF / "constraints").glob("*.yaml") if path.stem != "all")
    nodes: list[Any] = [OmegaConf.to_container(OmegaConf.load(path)) for path in paths]
    return [ConstraintSet(path.stem, **node[path.stem]) for path, node in zip(paths, nodes, strict=True)]


class Watching(NullObserver):
    """Keeps what is stored of every step, and how it is judged."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._scenes: list[Scene] = []
        self._steps: list[list[Any]] = []
        self._judged: list[Any] = []

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, Any]) -> None:
        self._scenes.append(scene)
        self._steps.append([x.astype(np.float32) for x in (scene.qpos, scene.qvel, action)])
        verdict = SuccessEvaluator(self._task, self._scenes[0])(scene)
        self._judged.append([verdict.evidence, verdict.success_paper])

    def digests(self) -> dict[str, str]:
        """`bytes` has one for each second, so that an episode that only ends at another time shows."""
        seconds = [self._steps[k : k + CONTROL_HZ] for k in range(0, len(self._steps), CONTROL_HZ)]
        return {
            "bytes": " ".join(digest(second)[:8] for second in seconds),
            "judged": digest(np.array(self._judged, object).tolist()),
        }


def of(task: Task, constraints: list[ConstraintSet]) -> Digests:
    """Versions and digests of one task."""
    plans = [json.loads(to_json(task.module.plan(start_scene(task, seed), task))) for seed in PLANS]
    found: Digests = {
        "processor": processor(),
        "generator": GENERATOR,
        "plan_version": task.plan_version,
        "version": task.version,
        "plan": digest(plans),
        "rows": {},
    }
    with Simulator(task, render=False) as world:
        for row in constraints:
            watching = Watching(task)
            settings = Settings.configured(task, row, ScriptedSpec())
            EpisodeGenerator(settings, world, settings.make_brain(SEED), watching).make(SEED)
            found["rows"][row.name] = watching.digests()
    return found


@cache
def processor() -> str:
    """The kind that this is: vendor, family and model, where the system tells."""
    found: dict[str, str] = {}
    with suppress(OSError):  # not Linux
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        found = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    told = [found[key] for key in ("vendor_id", "cpu family", "model") if key in found]
    return " ".join(told) or platform.machine()


def elsewhere(recorded: Digests | None, found: Digests) -> bool:
    """Whether bytes differ, but on another kind of processor, and all else is as recorded."""
    return (
        recorded is not None
        and recorded["processor"] != found["processor"]
        and recorded["rows"] != found["rows"]
        and _but_bytes(recorded) == _but_bytes(found)
    )


def _but_bytes(digests: Digests) -> Digests:
    rows = {name: {**each, "bytes": len(each["bytes"].split())} for name, each in digests["rows"].items()}
    return {**digests, "rows": rows, "processor": None}


def complaint(task: Task, recorded: Digests | None, found: Digests) -> str:
    """What has to be done before the digests of a task are as recorded; empty where they are."""
    again = f"then take its digests anew: python -m tests.golden {task.name}"
    if recorded is None:
        return f"{task.name} has no digests; {again}"
    if {**recorded, "processor": found["processor"]} == found or elsewhere(recorded, found):
        return ""
    kept = {key: recorded[key] for key in ("generator", "plan_version", "version")}
    if any(found[key] != value for key, value in kept.items()):
        return f"{task.name} has digests of {kept}; {again}"
    changed = [name for name in found["rows"] if found["rows"][name] != recorded["rows"].get(name)]
    module, generator = task.module.__name__, "GENERATOR in rf_exp.datagen.version"
    if found["plan"] != recorded["plan"]:
        what, raised = "its plan", f"PLAN_VERSION in {module}"
    elif all(_only_judged(recorded["rows"].get(name, {}), found["rows"][name]) for name in changed):
        what, raised = f"when it counts as solved (rows {', '.join(changed)})", f"VERSION in {module}"
    else:
        what = f"its bytes (rows {', '.join(changed)})"
        raised = f"{generator}, or PLAN_VERSION in {module} where only this plan does something else"
    return f"{task.name}: {what} changed, and its versions did not; raise {raised}, {again}"


def _only_judged(recorded: Mapping[str, str], found: Mapping[str, str]) -> bool:
    """Whether what is done is the same, but for when it ends."""
    if "bytes" not in recorded:
        return False
    old, new = recorded["bytes"].split()[:-1], found["bytes"].split()[:-1]  # the last second may be cut
    shared = min(len(old), len(new))
    return recorded["judged"] != found["judged"] and old[:shared] == new[:shared]


def read() -> dict[str, Digests]:
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def main() -> int:
    parser = argparse.ArgumentParser("python -m tests.golden", description="Takes the golden digests anew.")
    parser.add_argument("tasks", nargs="*", help=f"of {', '.join(TASKS)}; all unless given")
    parser.add_argument("--same-versions", action="store_true", help="take what changed without one raised")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.tasks) - set(TASKS)):
        parser.error(f"no task {unknown[0]!r}; available: {', '.join(TASKS)}")
    recorded, refused = read(), 0
    for name in arguments.tasks or TASKS:
        task = read_task(name)
        found, before = of(task, rows()), recorded.get(name)
        problem = complaint(task, before, found)
        raised = before is None or any(
            before[key] != found[key] for key in ("generator", "plan_version", "version")
        )
        if problem and not raised and not arguments.same_versions:
            print(problem, file=sys.stderr)
            refused += 1
            continue
        if problem or (arguments.same_versions and elsewhere(before, found)):
            recorded[name] = found
            print(f"{name}: taken anew", flush=True)
        else:
            bytes_of = ", but for bytes, taken on another kind of processor" * elsewhere(before, found)
            print(f"{name}: unchanged{bytes_of}", flush=True)
    write_json(FILE, dict(sorted(recorded.items())))
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
