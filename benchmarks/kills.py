"""Crash safety of runs: kills them at random times and compares the artifacts with an undisturbed run.

    python benchmarks/kills.py [--kills 30] [--stages generate,train,evaluate] [--seed 0] [--folder DIR]

Every trial starts a stage of a tiny experiment, kills the whole group, the command alone or one of its
workers, by SIGKILL or SIGTERM, at a random moment of its work, and then runs the same command again. The
final artifacts are compared with an undisturbed run: bytes of demonstrations and policies, rows without their
times. Results are kept in DIR/log.jsonl, which the same command continues. The last line is JSON: for every
stage the kills that hit a run at work, and how many of them left equal artifacts, one row per seed, no
process after 5 s, no temporary file; and the longest time until all processes had ended.
"""

import argparse
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

TINY = (
    "demos=3",
    "scenes=3",
    "recordings=0",
    "films=0",
    "workers=2",
    "wandb=disabled",
    "picture={width: 64, height: 48}",
    "policy.head.diffusion.channels=[8,16]",
    "policy.head.diffusion.inference_steps=2",
    "training.steps=60",
    "policy.encoder.keypoints.steps=20",
    "policy.head.refined.regression_steps=20",
    "training.batch_size=8",
    "training.log_every=5",
    "training.checkpoint_every=10",
)
STAGES = {  # stage -> folders that it needs from earlier ones
    "generate": (),
    "train": ("data", "results/generate"),
    "evaluate": ("data", "results/generate", "policies"),
}
KILLS = [
    (who, number) for number in (signal.SIGKILL, signal.SIGTERM) for who in ("group", "parent", "worker")
]
EXIT_LIMIT_S = 5.0
HANG_LIMIT_S = 600.0  # after which a run counts as hanging
TIMES = ("wall_s", "crc32")  # fields of a row to ignore; the checksum includes the time
CURVE = ("step", "steps", "epoch", "loss", "learning_rate")  # columns of a training curve other than times


def start(stage: str, out: Path) -> subprocess.Popen[bytes]:
    """Starts the command in a session of its own, with its output in `out/said.txt`."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / "said.txt").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "rf_exp.run", *TINY, f"stages=[{stage}]", f"out={out}"],
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def status(pid: int | str) -> list[str]:
    """State, parent, group, session, ... of a process; empty when it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return []


def session(leader: int) -> list[int]:
    """All processes of a session except zombies."""
    pids = (path.name for path in Path("/proc").glob("[0-9]*"))
    return [int(pid) for pid in pids if (s := status(pid)) and int(s[3]) == leader and s[0] != "Z"]


def workers(leader: int) -> list[int]:
    """The worker processes of a run."""
    worker_pids = []
    for pid in session(leader):
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if b"spawn_main" in command and int((status(pid) or [0, 0])[1]) == leader:
            worker_pids.append(pid)
    return worker_pids


def at_work(run: subprocess.Popen[bytes]) -> bool:
    """Waits until the run has workers; False when it ends without."""
    end = time.monotonic() + HANG_LIMIT_S
    while run.poll() is None and time.monotonic() < end:
        if workers(run.pid):
            return True
        time.sleep(0.02)
    return False


def content(out: Path) -> dict[str, Any]:
    """Path -> content that must equal that of an undisturbed run."""
    contents: dict[str, Any] = {}
    for path in sorted(path for part in ("data", "policies") for path in (out / part).rglob("*")):
        name = str(path.relative_to(out))
        if path.suffix == ".lock" or not path.is_file():
            continue
        if path.name == "curves.csv":
            with path.open(newline="") as file:
                contents[name] = [[row[column] for column in CURVE] for row in csv.DictReader(file)]
        else:
            contents[name] = path.read_bytes()
    for name, rows in all_rows(out):
        contents[name] = [{key: value for key, value in row.items() if key not in TIMES} for row in rows]
    return contents


def all_rows(out: Path) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    for path in sorted((out / "results").rglob("*.jsonl")):
        yield str(path.relative_to(out)), [json.loads(line) for line in path.read_text().splitlines()]


def repeated(out: Path) -> list[int]:
    """Seeds with more than one row."""
    seeds = [
        Counter(row.get("scene_seed", row.get("seed")) for row in rows).items() for _, rows in all_rows(out)
    ]
    return [int(seed or 0) for counts in seeds for seed, count in counts if count > 1]


def temporary(out: Path) -> list[str]:
    names = (path for path in out.rglob("*") if "runs" not in path.relative_to(out).parts)
    return [str(path) for path in names if "partial" in path.name or path.name == "state.safetensors"]


def trial(stage: str, number: int, seed: int, reference: Path, work_s: float, out: Path) -> dict[str, Any]:
    """Result of one kill, and of the same command after it."""
    rng = np.random.default_rng([seed, list(STAGES).index(stage), number])
    target, signal_number = KILLS[number % len(KILLS)]
    shutil.rmtree(out, ignore_errors=True)
    for part in STAGES[stage]:
        shutil.copytree(reference / part, out / part)
    result: dict[str, Any] = {"stage": stage, "trial": number, "who": target, "signal": signal_number.name}
    began, run = time.monotonic(), start(stage, out)
    if at_work(run):
        at_work_since = time.monotonic()
        result["after_s"] = round(rng.uniform(0.0, work_s), 2)
        with suppress(subprocess.TimeoutExpired):
            run.wait(result["after_s"])
            result["work_s"] = round(time.monotonic() - at_work_since, 2)  # ended before the kill
    victims = {"group": session(run.pid), "parent": [run.pid], "worker": workers(run.pid)}[target]
    result["hit"] = run.poll() is None and bool(victims)
    if result["hit"]:
        if target == "group":
            os.killpg(run.pid, signal_number)
        else:
            os.kill(int(rng.choice(victims)), signal_number)
    killed, result["gone_s"] = time.monotonic(), None
    while time.monotonic() - killed < (EXIT_LIMIT_S if result["hit"] else HANG_LIMIT_S):
        if run.poll() is not None and not session(run.pid):
            result["gone_s"] = round(time.monotonic() - killed, 2)
            break
        time.sleep(0.02)
    result["left"] = len(session(run.pid))
    for pid in session(run.pid):
        os.kill(pid, signal.SIGKILL)
    result["code"] = run.wait()
    again = start(stage, out)
    result["code_again"] = again.wait(HANG_LIMIT_S)
    expected, actual = content(reference), content(out)
    names = [name for name in expected if belongs(stage, name)]
    result["differing"] = [name for name in names if expected[name] != actual.get(name)]
    result["differing"] += [name for name in actual if belongs(stage, name) and name not in expected]
    result["repeated"], result["temporary"] = repeated(out), temporary(out)
    result["wall_s"] = round(time.monotonic() - began, 1)
    return result


def belongs(stage: str, name: str) -> bool:
    """Whether a file exists once a stage is done."""
    later = {"generate": ("policies", "results/evaluate"), "train": ("results/evaluate",), "evaluate": ()}
    return not name.startswith(later[stage])


def undisturbed(reference: Path) -> dict[str, float]:
    """Runs the whole experiment once; returns the seconds of each stage since its first worker started."""
    path = reference / "seconds.json"
    if not path.exists():
        shutil.rmtree(reference, ignore_errors=True)
        seconds = {}
        for stage in STAGES:
            run = start(stage, reference)
            assert at_work(run), (reference / "said.txt").read_text()
            began = time.monotonic()
            if run.wait(HANG_LIMIT_S):
                raise SystemExit((reference / "said.txt").read_text())
            seconds[stage] = time.monotonic() - began
        path.write_text(json.dumps(seconds))
    return json.loads(path.read_text())


def summary(trials: list[Mapping[str, Any]]) -> dict[str, Any]:
    hits = [trial for trial in trials if trial["hit"]]
    return {
        "kills": len(hits),
        "ended": sum(trial["code_again"] == 0 for trial in hits),
        "equal": sum(not trial["differing"] for trial in hits),
        "one_row_a_seed": sum(not trial["repeated"] for trial in hits),
        "gone_in_5_s": sum(trial["left"] == 0 and trial["gone_s"] is not None for trial in hits),
        "longest_s": max((trial["gone_s"] or EXIT_LIMIT_S for trial in hits), default=None),
        "nothing_temporary": sum(not trial["temporary"] for trial in hits),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=30, help="that hit, of each stage")
    parser.add_argument("--stages", default=",".join(STAGES), help="with commas between")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("outputs/kills"))
    args = parser.parse_args()
    folder = args.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    log, work_s = folder / "log.jsonl", undisturbed(folder / "whole")
    done = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    for stage in args.stages.split(","):
        of_stage = [trial_result for trial_result in done if trial_result["stage"] == stage]
        number = len(of_stage)
        while sum(trial_result["hit"] for trial_result in of_stage) < args.kills:
            # The machine may have become faster since; kills should hit a run at work.
            lasts_s = min(
                [
                    work_s[stage],
                    *(trial_result["work_s"] for trial_result in of_stage if "work_s" in trial_result),
                ]
            )
            result = trial(stage, number, args.seed, folder / "whole", lasts_s, folder / "trial")
            number += 1
            for results in (of_stage, done):
                results.append(result)
            with log.open("a") as file:
                file.write(json.dumps(result) + "\n")
            print(json.dumps(result), flush=True)
    by_stage = {
        stage: summary([trial_result for trial_result in done if trial_result["stage"] == stage])
        for stage in STAGES
    }
    print(json.dumps({"benchmark": "kills", **by_stage}))


if __name__ == "__main__":
    main()
