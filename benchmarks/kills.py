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
TARGETS = [
    (who, number) for number in (signal.SIGKILL, signal.SIGTERM) for who in ("group", "parent", "worker")
]
GONE_S = 5.0
HANG_S = 600.0  # after which a run counts as hanging
TIMES = ("wall_s", "crc32")  # fields of a row to ignore; the checksum includes the time
CURVE = ("step", "steps", "epoch", "loss", "learning_rate")  # columns of a training curve other than times


def start(stage: str, out: Path) -> subprocess.Popen[bytes]:
    """Starts the command in a session of its own, with its output in `out/said.txt`."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / "said.txt").open("ab") as said:
        return subprocess.Popen(
            [sys.executable, "-m", "rf_exp.run", *TINY, f"stages=[{stage}]", f"out={out}"],
            stdout=said,
            stderr=said,
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
    found = []
    for pid in session(leader):
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if b"spawn_main" in command and int((status(pid) or [0, 0])[1]) == leader:
            found.append(pid)
    return found


def at_work(run: subprocess.Popen[bytes]) -> bool:
    """Waits until the run has workers; False when it ends without."""
    end = time.monotonic() + HANG_S
    while run.poll() is None and time.monotonic() < end:
        if workers(run.pid):
            return True
        time.sleep(0.02)
    return False


def content(out: Path) -> dict[str, Any]:
    """Path -> content that must equal that of an undisturbed run."""
    found: dict[str, Any] = {}
    for path in sorted(path for part in ("data", "policies") for path in (out / part).rglob("*")):
        name = str(path.relative_to(out))
        if path.suffix == ".lock" or not path.is_file():
            continue
        if path.name == "curves.csv":
            with path.open(newline="") as file:
                found[name] = [[row[column] for column in CURVE] for row in csv.DictReader(file)]
        else:
            found[name] = path.read_bytes()
    for name, rows in all_rows(out):
        found[name] = [{key: value for key, value in row.items() if key not in TIMES} for row in rows]
    return found


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


def trial(stage: str, number: int, seed: int, whole: Path, work_s: float, out: Path) -> dict[str, Any]:
    """Result of one kill, and of the same command after it."""
    rng = np.random.default_rng([seed, list(STAGES).index(stage), number])
    who, sign = TARGETS[number % len(TARGETS)]
    shutil.rmtree(out, ignore_errors=True)
    for part in STAGES[stage]:
        shutil.copytree(whole / part, out / part)
    result: dict[str, Any] = {"stage": stage, "trial": number, "who": who, "signal": sign.name}
    began, run = time.monotonic(), start(stage, out)
    if at_work(run):
        at_work_since = time.monotonic()
        result["after_s"] = round(rng.uniform(0.0, work_s), 2)
        with suppress(subprocess.TimeoutExpired):
            run.wait(result["after_s"])
            result["work_s"] = round(time.monotonic() - at_work_since, 2)  # ended before the kill
    victims = {"group": session(run.pid), "parent": [run.pid], "worker": workers(run.pid)}[who]
    result["hit"] = run.poll() is None and bool(victims)
    if result["hit"]:
        if who == "group":
            os.killpg(run.pid, sign)
        else:
            os.kill(int(rng.choice(victims)), sign)
    killed, result["gone_s"] = time.monotonic(), None
    while time.monotonic() - killed < (GONE_S if result["hit"] else HANG_S):
        if run.poll() is not None and not session(run.pid):
            result["gone_s"] = round(time.monotonic() - killed, 2)
            break
        time.sleep(0.02)
    result["left"] = len(session(run.pid))
    for pid in session(run.pid):
        os.kill(pid, signal.SIGKILL)
    result["code"] = run.wait()
    again = start(stage, out)
    result["code_again"] = again.wait(HANG_S)
    was, now = content(whole), content(out)
    ours = [name for name in was if belongs(stage, name)]
    result["differing"] = [name for name in ours if was[name] != now.get(name)]
    result["differing"] += [name for name in now if belongs(stage, name) and name not in was]
    result["repeated"], result["temporary"] = repeated(out), temporary(out)
    result["wall_s"] = round(time.monotonic() - began, 1)
    return result


def belongs(stage: str, name: str) -> bool:
    """Whether a file exists once a stage is done."""
    later = {"generate": ("policies", "results/evaluate"), "train": ("results/evaluate",), "evaluate": ()}
    return not name.startswith(later[stage])


def undisturbed(whole: Path) -> dict[str, float]:
    """Runs the whole experiment once; returns the seconds of each stage since its first worker started."""
    path = whole / "seconds.json"
    if not path.exists():
        shutil.rmtree(whole, ignore_errors=True)
        seconds = {}
        for stage in STAGES:
            run = start(stage, whole)
            assert at_work(run), (whole / "said.txt").read_text()
            began = time.monotonic()
            if run.wait(HANG_S):
                raise SystemExit((whole / "said.txt").read_text())
            seconds[stage] = time.monotonic() - began
        path.write_text(json.dumps(seconds))
    return json.loads(path.read_text())


def summary(trials: list[Mapping[str, Any]]) -> dict[str, Any]:
    hits = [each for each in trials if each["hit"]]
    return {
        "kills": len(hits),
        "ended": sum(each["code_again"] == 0 for each in hits),
        "equal": sum(not each["differing"] for each in hits),
        "one_row_a_seed": sum(not each["repeated"] for each in hits),
        "gone_in_5_s": sum(each["left"] == 0 and each["gone_s"] is not None for each in hits),
        "longest_s": max((each["gone_s"] or GONE_S for each in hits), default=None),
        "nothing_temporary": sum(not each["temporary"] for each in hits),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=30, help="that hit, of each stage")
    parser.add_argument("--stages", default=",".join(STAGES), help="with commas between")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("outputs/kills"))
    given = parser.parse_args()
    folder = given.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    log, work_s = folder / "log.jsonl", undisturbed(folder / "whole")
    done = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    for stage in given.stages.split(","):
        of_stage = [each for each in done if each["stage"] == stage]
        number = len(of_stage)
        while sum(each["hit"] for each in of_stage) < given.kills:
            # The machine may have become faster since; kills should hit a run at work.
            lasts_s = min([work_s[stage], *(each["work_s"] for each in of_stage if "work_s" in each)])
            result = trial(stage, number, given.seed, folder / "whole", lasts_s, folder / "trial")
            number += 1
            for kept in (of_stage, done):
                kept.append(result)
            with log.open("a") as file:
                file.write(json.dumps(result) + "\n")
            print(json.dumps(result), flush=True)
    by_stage = {stage: summary([each for each in done if each["stage"] == stage]) for stage in STAGES}
    print(json.dumps({"benchmark": "kills", **by_stage}))


if __name__ == "__main__":
    main()
