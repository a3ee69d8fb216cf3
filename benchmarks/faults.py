"""Detection rate of the checks for every named fault, and their false alarms on clean plans.

    python benchmarks/faults.py [--seeds 1] [--clean 110] [--tasks all] [--faults all] [--workers 1]
                                [--log FILE]

Clean plans: the first proposal of the scripted brain, planned, scheduled and checked, without motion. One
that is returned to the brain is an alarm. Faults: every fault on every task with scripted plans to which it
applies, one episode per seed: is the fault found, by which check, before any motion, and does the episode
succeed after the brain has been informed? With --log every result is a line of that file, and results that
it has are not computed again. The last line is JSON with the totals.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf

from rf_exp.constraints import CONTACT_N
from rf_exp.datagen import EpisodeGenerator, NullObserver, Planned, Settings
from rf_exp.datagen.brain import FAULTS, Brain, FaultyBrain, FaultySpec, Question, ScriptedSpec, fault_applies
from rf_exp.errors import unknown_choice
from rf_exp.findings import Violation
from rf_exp.processes import in_order
from rf_exp.sim import shared_simulator
from rf_exp.tasks import Task, load_task
from rf_exp.texts import markdown
from rf_exp.types import NO_PICTURES, CameraModel, ConstraintSet, Scene, SeeingWorld

CONF = Path(__file__).resolve().parents[1] / "conf" / "task"
FULL, WITHOUT_PICTURES = ConstraintSet("full"), NO_PICTURES


@dataclass(frozen=True)
class CleanResult:
    """Result of one clean plan. `check` and `reason` are empty unless it was an alarm."""

    task: str
    seed: int
    check: str
    reason: str
    wall_s: float
    part: str = "clean"
    fault: str = ""


@dataclass(frozen=True)
class FaultResult:
    """Result of one episode with a fault. `check` and `reason` are empty when it was not found."""

    task: str
    fault: str
    seed: int
    placed: bool  # whether the episode had a proposal to which the fault applies
    check: str
    reason: str
    moved_steps: int  # control steps between the faulty proposal and its rejection
    contact: bool  # whether arms touched in these steps
    success: bool
    repairs: int  # proposals beyond those of a sound plan
    end: str  # why the episode failed
    wall_s: float
    part: str = "faulty"


class _VerdictReached(Exception):
    """Ends an episode with the verdict on its first proposal: a plan to execute, or a violation."""

    def __init__(self, verdict: Planned | Violation) -> None:
        self.verdict = verdict


class FirstJudgement(NullObserver):
    """Observer that ends the episode once its first proposal has been judged."""

    def planned(self, plan: Planned) -> None:
        raise _VerdictReached(plan)

    def rejected(self, violation: Violation) -> None:
        raise _VerdictReached(violation)


def clean(task: Task, seed: int) -> CleanResult:
    settings, began = Settings.configured(task, FULL, ScriptedSpec()), time.perf_counter()
    try:
        EpisodeGenerator(
            settings, shared_simulator(task, WITHOUT_PICTURES), settings.make_brain(seed), FirstJudgement()
        ).make(seed)
        verdict: Planned | Violation | None = None
    except _VerdictReached as reached:
        verdict = reached.verdict
    assert verdict is not None, f"{task.name}, seed {seed}: the scripted brain proposes nothing"
    check, reason = (verdict.check, verdict.sentence) if isinstance(verdict, Violation) else ("", "")
    return CleanResult(task.name, seed, check, reason, round(time.perf_counter() - began, 2))


class Watched:
    """World that records motion and contacts between a faulty proposal and its rejection."""

    def __init__(self, world: SeeingWorld, brain: FaultyBrain) -> None:
        self._world, self._brain = world, brain
        self.watching = True
        self.moved_steps, self.contact = 0, False

    @property
    def cameras(self) -> tuple[str, ...]:
        return self._world.cameras

    def reset(self, seed: int) -> Scene:
        return self._world.reset(seed)

    def step(self, action: NDArray[np.float64]) -> Scene:
        scene = self._world.step(action)
        if self._brain.inserted and self.watching:
            self.moved_steps += 1
            self.contact |= any(force_n > CONTACT_N for *_, force_n in scene.arm_contacts)
        return scene

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        return self._world.images(cameras)

    def depth(self) -> dict[str, NDArray[np.float32]]:
        return self._world.depth()

    def camera_models(self) -> dict[str, CameraModel]:
        return self._world.camera_models()


class FirstRejection(NullObserver):
    """Observer that keeps the violation by which the faulty proposal is rejected."""

    def __init__(self, world: Watched, brain: FaultyBrain) -> None:
        self._world, self._brain = world, brain
        self.violation: Violation | None = None

    def rejected(self, violation: Violation) -> None:
        if self._brain.inserted and self.violation is None:
            self.violation, self._world.watching = violation, False


def faulty(task: Task, fault: str, seed: int) -> FaultResult:
    spec = FaultySpec(fault)
    brain = spec.make(task, FULL, seed)
    world = Watched(shared_simulator(task, WITHOUT_PICTURES), brain)
    observer = FirstRejection(world, brain)
    outcome = EpisodeGenerator(Settings.configured(task, FULL, spec), world, brain, observer).make(seed)
    violation = observer.violation
    return FaultResult(
        task.name,
        fault,
        seed,
        brain.inserted,
        violation.check if violation else "",
        violation.sentence if violation else "",
        world.moved_steps,
        world.contact,
        outcome.success,
        outcome.attempts - 1,
        outcome.reason,
        round(outcome.wall_s, 2),
    )


class Surveyor:
    """Scripted brain that records the faults that apply to its proposals."""

    name = "surveyor"

    def __init__(self, brain: Brain) -> None:
        self._brain = brain
        self.room: set[str] = set()

    def answer(self, question: Question) -> str:
        self.room |= {fault for fault in FAULTS if fault_applies(fault, question.task, question.scene)}
        return self._brain.answer(question)


def applicable_faults(task: Task) -> set[str]:
    """The faults that apply to some proposal of a sound episode of a task."""
    settings = Settings.configured(task, FULL, ScriptedSpec())
    brain = Surveyor(settings.make_brain(0))
    EpisodeGenerator(settings, shared_simulator(task, WITHOUT_PICTURES), brain).make(0)
    return brain.room


Key = tuple[str, str, str, int]  # part, task, fault, seed


def key(row: Mapping[str, Any]) -> Key:
    return row["part"], row["task"], row["fault"], row["seed"]


def jobs(
    tasks: Sequence[Task], faults: Sequence[str], seeds: int, plans: int, known: Mapping[Key, dict[str, Any]]
) -> Iterator[Any]:
    """The remaining jobs, task by task, so that simulators are reused."""
    for index, task in enumerate(tasks):
        for seed in range(plans * index // len(tasks), plans * (index + 1) // len(tasks)):
            if ("clean", task.name, "", seed) not in known:
                yield partial(clean, task, seed)
        cells = [
            (fault, seed)
            for fault in faults
            for seed in range(seeds)
            if ("faulty", task.name, fault, seed) not in known
        ]
        applicable = applicable_faults(task) if cells else set()
        for fault, seed in cells:
            if fault in applicable:
                yield partial(faulty, task, fault, seed)


HEADINGS = (
    "fault",
    "tasks",
    "episodes",
    "found",
    "before motion",
    "touched",
    "found by",
    "success",
    "repairs",
)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown table with one line per fault."""
    lines = []
    for name, fault in FAULTS.items():
        if fault_rows := [row for row in rows if row["fault"] == name]:
            lines.append((f"`{name}`{'' if fault.breaks else ' (*)'}", *cells(fault_rows)))
    return markdown.table(HEADINGS, lines)


def cells(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """The cells of the table for the episodes of one fault."""
    detected = [row for row in rows if row["check"]]
    checks = Counter(row["check"] for row in detected).most_common()
    return (
        str(len({row["task"] for row in rows})),
        str(len(rows)),
        share(len(detected), rows),
        share(sum(not row["moved_steps"] for row in detected), rows),
        str(sum(row["contact"] for row in rows)),
        ", ".join(f"{check} {count}" for check, count in checks),
        share(sum(row["success"] for row in rows), rows),
        f"{mean(row['repairs'] for row in rows):.2f}",
    )


def share(count: int, among: Sequence[object]) -> str:
    return f"{count / len(among):.0%}"


def totals(rows: Sequence[Mapping[str, Any]]) -> dict[str, object]:
    """Alarms over clean plans; found, touched and repaired over the faults that break a constraint."""
    plans = [row for row in rows if row["part"] == "clean"]
    placed = [row for row in rows if row["part"] == "faulty" and row["placed"]]
    broken = [row for row in placed if FAULTS[row["fault"]].breaks]

    def percent(count: int, among: Sequence[object]) -> float | None:
        return round(100 * count / len(among), 2) if among else None

    return {
        "benchmark": "faults",
        "clean_plans": len(plans),
        "alarms": sum(bool(row["check"]) for row in plans),
        "alarm_pct": percent(sum(bool(row["check"]) for row in plans), plans),
        "faulty_episodes": len(placed),
        "without_room": sum(row["part"] == "faulty" and not row["placed"] for row in rows),
        "breaking_episodes": len(broken),
        "missed": sum(not row["check"] for row in broken),
        "found_pct": percent(sum(bool(row["check"]) for row in broken), broken),
        "found_before_motion_pct": percent(
            sum(bool(row["check"]) and not row["moved_steps"] for row in broken), broken
        ),
        "contact_before_found": sum(row["contact"] for row in broken),
        "success_pct": percent(sum(row["success"] for row in placed), placed),
        "success_breaking_pct": percent(sum(row["success"] for row in broken), broken),
        "repairs_mean": round(mean(row["repairs"] for row in broken), 3) if broken else None,
    }


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints the table, the alarms and failures, and the JSON."""
    faults = [row for row in rows if row["part"] == "faulty" and row["placed"]]
    print(table(faults), "\n\n(*) leaves a demand out and breaks none, so that nothing need be found.")
    for row in rows:
        if row["part"] == "clean" and row["check"]:
            print(f"alarm: {row['task']} {row['seed']}: {row['check']}: {row['reason'][:200]}")
    for row in faults:
        if FAULTS[row["fault"]].breaks and (not row["check"] or row["contact"]):
            problem = f"found late by {row['check']}" if row["check"] else "missed"
            print(f"{problem}: {row['fault']} on {row['task']} {row['seed']}: {row['reason'][:200]}")
        if not row["success"]:
            print(f"not repaired: {row['fault']} on {row['task']} {row['seed']}: {row['end'][:300]}")
    print(json.dumps(totals(rows)))


def named(text: str, known: Iterable[str], kind: str) -> list[str]:
    """Parses `all`, or names separated by commas. Raises ArgumentError for an unknown name."""
    known = list(known)
    names = known if text == "all" else text.split(",")
    for name in names:
        if name not in known:
            raise unknown_choice(kind, name, known)
    return names


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=1, help="episodes of each fault on each task")
    parser.add_argument("--clean", type=int, default=110, help="clean plans, spread over the tasks")
    parser.add_argument("--tasks", default="all", help="with commas between")
    parser.add_argument("--faults", default="all", help="with commas between")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--log", type=Path, help="keep results here, and continue from it")
    args = parser.parse_args()
    names = named(args.tasks, sorted(path.stem for path in CONF.glob("*.yaml")), "task")
    faults = named(args.faults, FAULTS, "fault")
    tasks = []
    for name in names:
        config = OmegaConf.to_object(OmegaConf.load(CONF / f"{name}.yaml"))
        assert isinstance(config, dict)
        tasks.append(load_task(name, config[name]))

    lines = args.log.read_text().splitlines() if args.log and args.log.exists() else []
    rows = {key(row): row for row in map(json.loads, lines)}
    for result in in_order(jobs(tasks, faults, args.seeds, args.clean, rows), args.workers):
        row = asdict(result)
        rows[key(row)] = row
        if args.log:
            with args.log.open("a") as log:
                log.write(json.dumps(row) + "\n")
    report(list(rows.values()))


if __name__ == "__main__":
    main()
