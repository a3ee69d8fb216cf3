"""Digests of the first episode of every task under every row of constraints, stored in golden.json.

    python -m tests.golden                    takes them anew, about a minute of one core
    python -m tests.golden lift_barrier       of these tasks only

The digests of bytes were recorded on one kind of processor. On another, values may differ in their last bit
although `rf_exp` selects the same kernels; plans and the judgement of each step must still be as recorded.

The digests enforce a new version wherever bytes change, so that old and new demonstrations never share a
store: digests that changed under the same versions are refused. As long as nobody has data of a version,
`--same-versions` accepts them.
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
PLANS = range(8)  # seeds whose first proposals are recorded
Digests = dict[str, Any]


def rows() -> list[ConstraintSet]:
    paths = sorted(path for path in (CONF / "constraints").glob("*.yaml") if path.stem != "all")
    nodes: list[Any] = [OmegaConf.to_container(OmegaConf.load(path)) for path in paths]
    return [ConstraintSet(path.stem, **node[path.stem]) for path, node in zip(paths, nodes, strict=True)]


class EpisodeRecorder(NullObserver):
    """Records the stored values and the judgement of every step."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._scenes: list[Scene] = []
        self._steps: list[list[Any]] = []
        self._judgements: list[Any] = []

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, Any]) -> None:
        self._scenes.append(scene)
        self._steps.append([x.astype(np.float32) for x in (scene.qpos, scene.qvel, action)])
        verdict = SuccessEvaluator(self._task, self._scenes[0])(scene)
        self._judgements.append([verdict.evidence, verdict.success_paper])

    def digests(self) -> dict[str, str]:
        """`bytes` has one digest per second, which tells a change of length from a change of content."""
        seconds = [self._steps[k : k + CONTROL_HZ] for k in range(0, len(self._steps), CONTROL_HZ)]
        return {
            "bytes": " ".join(digest(second)[:8] for second in seconds),
            "judged": digest(np.array(self._judgements, object).tolist()),
        }


def digests_of(task: Task, constraints: list[ConstraintSet]) -> Digests:
    """Versions and digests of one task."""
    plans = [json.loads(to_json(task.module.plan(start_scene(task, seed), task))) for seed in PLANS]
    digests: Digests = {
        "processor": processor(),
        "generator": GENERATOR,
        "plan_version": task.plan_version,
        "version": task.version,
        "plan": digest(plans),
        "rows": {},
    }
    with Simulator(task, render=False) as world:
        for row in constraints:
            recorder = EpisodeRecorder(task)
            settings = Settings.configured(task, row, ScriptedSpec())
            EpisodeGenerator(settings, world, settings.make_brain(SEED), recorder).make(SEED)
            digests["rows"][row.name] = recorder.digests()
    return digests


@cache
def processor() -> str:
    """Vendor, family and model of this processor, where the system reports them."""
    fields: dict[str, str] = {}
    with suppress(OSError):  # not Linux
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    parts = [fields[key] for key in ("vendor_id", "cpu family", "model") if key in fields]
    return " ".join(parts) or platform.machine()


def differs_by_processor(recorded: Digests | None, found: Digests) -> bool:
    """Whether only bytes differ, and the recorded ones are of another kind of processor."""
    return (
        recorded is not None
        and recorded["processor"] != found["processor"]
        and recorded["rows"] != found["rows"]
        and _without_bytes(recorded) == _without_bytes(found)
    )


def _without_bytes(digests: Digests) -> Digests:
    rows = {name: {**row, "bytes": len(row["bytes"].split())} for name, row in digests["rows"].items()}
    return {**digests, "rows": rows, "processor": None}


def required_action(task: Task, recorded: Digests | None, found: Digests) -> str:
    """What to do about digests that differ from the recorded ones; empty where they agree."""
    remedy = f"then take its digests anew: python -m tests.golden {task.name}"
    if recorded is None:
        return f"{task.name} has no digests; {remedy}"
    if {**recorded, "processor": found["processor"]} == found or differs_by_processor(recorded, found):
        return ""
    versions = {key: recorded[key] for key in ("generator", "plan_version", "version")}
    if any(found[key] != value for key, value in versions.items()):
        return f"{task.name} has digests of {versions}; {remedy}"
    changed = [name for name in found["rows"] if found["rows"][name] != recorded["rows"].get(name)]
    module, generator = task.module.__name__, "GENERATOR in rf_exp.datagen.version"
    if found["plan"] != recorded["plan"]:
        part, version = "its plan", f"PLAN_VERSION in {module}"
    elif all(_judgement_alone(recorded["rows"].get(name, {}), found["rows"][name]) for name in changed):
        part, version = f"when it counts as solved (rows {', '.join(changed)})", f"VERSION in {module}"
    else:
        part = f"its bytes (rows {', '.join(changed)})"
        version = f"{generator}, or PLAN_VERSION in {module} where only this plan does something else"
    return f"{task.name}: {part} changed, and its versions did not; raise {version}, {remedy}"


def _judgement_alone(recorded: Mapping[str, str], found: Mapping[str, str]) -> bool:
    """Whether only the judgement changed: the motion is the same up to the end of the shorter episode."""
    if "bytes" not in recorded:
        return False
    # The last second may be incomplete.
    old, new = recorded["bytes"].split()[:-1], found["bytes"].split()[:-1]
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
        found, recorded_task = digests_of(task, rows()), recorded.get(name)
        problem = required_action(task, recorded_task, found)
        raised = recorded_task is None or any(
            recorded_task[key] != found[key] for key in ("generator", "plan_version", "version")
        )
        if problem and not raised and not arguments.same_versions:
            print(problem, file=sys.stderr)
            refused += 1
            continue
        if problem or (arguments.same_versions and differs_by_processor(recorded_task, found)):
            recorded[name] = found
            print(f"{name}: taken anew", flush=True)
        else:
            note = ", but for bytes, taken on another kind of processor" * differs_by_processor(
                recorded_task, found
            )
            print(f"{name}: unchanged{note}", flush=True)
    write_json(FILE, dict(sorted(recorded.items())))
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
