"""Equality of sharded runs with a single process, on every engine, with processes killed meanwhile.

    python benchmarks/shards.py [--engines dask,ray] [--kills 20] [--seed 0] [--folder DIR]

Engines have two nodes of one core each on this machine: Dask a scheduler and two workers, Ray a head and a
worker, with a token. First every engine makes the same demonstrations, without pictures, on seeds of which
some fail: for all seeds, and until enough have succeeded. Then a node of Dask and of Ray is killed with all
its processes during its work. Then workers, the processes of seeds, and commands are killed at random
moments, and a command that has ended is run again. All kills are SIGKILL. The final artifacts are compared:
SHA-256 over the files of the store, and over the rows without their times. Results are kept in DIR/log.jsonl,
which the same command continues. The last line is JSON.
"""

import argparse
import hashlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

OVERRIDES = (
    "stages=[generate]",
    "task=lift_barrier",
    "constraints=logical",
    "randomisation.mass_scale=1",
    "attempts=1",
)
OVERRIDES = (*OVERRIDES, "render=false", "recordings=0", "wandb=disabled", "launch.shard_seeds=2")
GOALS = ("episodes=8", "demos=5")  # the seeds 3 and 4 fail
ENGINES = ("loky", "dask", "ray", "submitit")
TARGETS = ("worker", "driver")
TIMES = ("wall_s", "commit", "crc32")  # fields of a row to ignore; the checksum includes the time
BIN = Path(sys.executable).parent
MARK_VARIABLE = (
    "RF_EXP_BENCHMARK"  # environment variable with the part of a process, whatever its parent is now
)
EXIT_LIMIT_S, HANG_LIMIT_S = 5.0, 1800.0


def processes(part: str = "") -> dict[int, int]:
    """Process -> parent, of the living processes of a part or of all parts."""
    mark, parent_of = f"\0{MARK_VARIABLE}={os.getpid()}/{part}".encode(), {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (path / "stat").read_text().rpartition(")")[2].split()[:2]
            if state != "Z" and mark in b"\0" + (path / "environ").read_bytes():
                parent_of[int(path.name)] = int(parent)
    return parent_of


def start(
    part: str, command: list[str], log_path: Path, environment: Mapping[str, str]
) -> subprocess.Popen[bytes]:
    marked = {**os.environ, **environment, MARK_VARIABLE: f"{os.getpid()}/{part}"}
    marked["SPT_NOENV"] = "1"  # or the process titles of Ray overwrite the mark
    with log_path.open("ab") as file:
        return subprocess.Popen(command, env=marked, stdout=file, stderr=file, start_new_session=True)


def kill(part: str) -> None:
    """Kills every process of a part, as if its machine had failed."""
    while pids := processes(part):
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)


class Cluster:
    """An engine on two nodes of this machine."""

    def __init__(self, engine: str, folder: Path) -> None:
        self.engine, self.folder = engine, folder
        self.environment: dict[str, str] = {}
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        if engine == "ray":
            (token := folder / "ray_token").write_text(secrets.token_hex(32))
            self.environment = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)}

    @property
    def arguments(self) -> list[str]:
        """Arguments of a command that uses this engine."""
        here = f"127.0.0.1:{self._port}"
        address = {"dask": f"tcp://{here}", "ray": here, "submitit": "local"}.get(self.engine, "null")
        return [f"launch.engine={self.engine}", f"launch.address={address}"]

    def start(self, name: str) -> None:
        """Starts the head, or another node."""
        here, port = "127.0.0.1", str(self._port)
        if self.engine == "dask":
            command = ["dask", "scheduler", "--host", here, "--port", port, "--no-dashboard"]
            if name != "head":
                command = ["dask", "worker", f"tcp://{here}:{port}", "--nthreads", "1", "--no-dashboard"]
                command += ["--memory-limit", "0", "--local-directory", str(self.folder)]
        else:
            where = ["--address", f"{here}:{port}"]
            if name == "head":
                where = ["--head", "--port", port, "--include-dashboard=false", "--disable-usage-stats"]
            command = ["ray", "start", *where, "--node-ip-address", here, "--num-cpus", "1", "--block"]
            command += ["--object-store-memory", "100000000"]
        command[0] = str(BIN / command[0])
        start(name, command, self.folder / f"{self.engine}-{name}.txt", self.environment)

    def answers(self) -> None:
        """Waits until the head accepts connections."""
        end = time.monotonic() + HANG_LIMIT_S
        while time.monotonic() < end:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self._port), timeout=1.0):
                return
            time.sleep(0.2)


@contextmanager
def running_cluster(engine: str, folder: Path) -> Iterator[Cluster]:
    """Context with a running engine, which is killed afterwards."""
    cluster = Cluster(engine, folder)
    nodes = {"dask": ("head", "node1", "node2"), "ray": ("head", "node2")}.get(engine, ())
    with ExitStack() as stack:
        for name in nodes:
            stack.callback(kill, name)
            cluster.start(name)
            cluster.answers()
        yield cluster


def command(cluster: Cluster, out: Path, goal: str, workers: int = 2) -> subprocess.Popen[bytes]:
    arguments = [*OVERRIDES, *cluster.arguments, goal, f"workers={workers}", f"out={out}"]
    log_path = cluster.folder / f"{cluster.engine}-said.txt"
    return start("driver", [sys.executable, "-m", "rf_exp.run", *arguments], log_path, cluster.environment)


def content(out: Path) -> str:
    """SHA-256 over the names and bytes of the store's files and over the rows without their times."""
    sha = hashlib.sha256()
    for path in sorted(path for path in out.glob("data/**/*.zarr/**/*") if path.is_file()):
        sha.update(str(path.relative_to(out)).encode() + path.read_bytes())
    for row in map(json.loads, lines(out)):
        sha.update(json.dumps({key: value for key, value in row.items() if key not in TIMES}).encode())
    return sha.hexdigest()


def lines(out: Path) -> list[str]:
    """The rows as lines of text."""
    return [line for path in sorted(out.glob("results/**/*.jsonl")) for line in path.read_text().splitlines()]


def finished(out: Path) -> list[str]:
    """The rows of finished shards."""
    shard_lines = [lines(shard) for shard in out.glob("shards/*/*-*")]
    return [line for rows in shard_lines if len(rows) == 2 for line in rows]


def cpu_s() -> dict[int, float]:
    """CPU seconds of every living process of ours."""
    seconds = {}
    for pid in processes():
        with suppress(OSError):
            ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
            seconds[pid] = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    return seconds


def cost(cluster: Cluster, out: Path, goal: str, workers: int) -> dict[str, Any]:
    """Content and cost, including nodes, of one undisturbed run."""
    shutil.rmtree(out, ignore_errors=True)
    began, before = time.monotonic(), cpu_s()
    seconds, run = dict(before), command(cluster, out, goal, workers)
    while run.poll() is None:
        seconds |= cpu_s()  # misses the last moment of each process
        time.sleep(0.25)
    spent_s = sum(seconds.values()) - sum(before.values())
    result = {"code": run.returncode, "sha": content(out), "shards_left": len([*out.glob("shards/*/*-*")])}
    return {**result, "wall_s": round(time.monotonic() - began, 1), "cpu_s": round(spent_s, 1)}


def seeds_at_work(part: str = "") -> dict[int, int]:
    """Process of a seed -> its parent, a process of the engine."""
    parents = processes(part).items()
    return {
        pid: parent
        for pid, parent in parents
        if "spawn_main" in command_line(pid) and "bin/dask" not in command_line(parent)
    }


def command_line(pid: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text()
    return ""


def orphans() -> list[int]:
    """Our processes whose parent is neither one of ours nor this process."""
    parents = processes()
    return [pid for pid, parent in parents.items() if parent not in parents and parent != os.getpid()]


def until(condition: Callable[[], object], seconds: float = HANG_LIMIT_S) -> bool:
    end = time.monotonic() + seconds
    while not (met := condition()) and time.monotonic() < end:
        time.sleep(0.1)
    return bool(met)


def kill_node(cluster: Cluster, out: Path, sha: str) -> dict[str, Any]:
    """Kills a node during its work, once a shard is finished; the command goes on."""
    shutil.rmtree(out, ignore_errors=True)
    run = command(cluster, out, GOALS[0])
    hit = until(lambda: run.poll() is not None or (finished(out) and seeds_at_work("node2")))
    kept, hit = finished(out), hit and run.poll() is None
    kill("node2")
    return {"hit": hit, "code": run.wait(HANG_LIMIT_S), **compare_artifacts(out, sha, kept)}


def kill_one(
    cluster: Cluster, target: str, work_s: float, rng: np.random.Generator, out: Path, sha: str
) -> dict[str, Any]:
    """Kills a worker, a seed's process or the command at a random moment; repeats a command that failed."""
    shutil.rmtree(out, ignore_errors=True)
    run, after_s = command(cluster, out, GOALS[0]), rng.uniform(0.0, work_s)
    until(lambda: run.poll() is not None or seeds_at_work())
    with suppress(subprocess.TimeoutExpired):
        run.wait(after_s)
    kept, victims = finished(out), [run.pid]
    if target == "worker":
        victims = sorted({pid for pair in seeds_at_work().items() for pid in pair})
    hit = run.poll() is None and bool(victims)
    if hit:
        os.kill(int(rng.choice(victims)), signal.SIGKILL)
    gone = None
    if target == "driver" and cluster.engine != "submitit":  # batch jobs are meant to outlive it
        gone = until(lambda: not processes("driver"), EXIT_LIMIT_S)
    code = again = run.wait(HANG_LIMIT_S)
    if code:
        again = command(cluster, out, GOALS[0]).wait(HANG_LIMIT_S)
    gone_in_the_end = until(
        lambda: not processes("driver") and not orphans() and not seeds_at_work(), EXIT_LIMIT_S
    )
    result = {"who": target, "after_s": round(after_s, 2), "hit": hit, "code": code, "gone_in_5_s": gone}
    return {**result, "code_again": again, "left": not gone_in_the_end, **compare_artifacts(out, sha, kept)}


def compare_artifacts(out: Path, sha: str, kept: list[str]) -> dict[str, Any]:
    """Verdict on the final artifacts; `kept` are the rows of shards that were finished before the kill."""
    seeds = [json.loads(line)["seed"] for line in lines(out)]
    return {
        "equal": content(out) == sha,
        "one_row_a_seed": seeds == sorted({*seeds}),
        "finished_before": len(kept),
        "made_again": len({*kept} - {*lines(out)}),
    }


class Log:
    """Results in a file, which the same command continues."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.results = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def of(self, **key: Any) -> list[dict[str, Any]]:
        return [result for result in self.results if key.items() <= result.items()]

    def add(self, **result: Any) -> None:
        self.results.append(result)
        with self._path.open("a") as file:
            file.write(json.dumps(result) + "\n")
        print(json.dumps(result), flush=True)


def measure_costs(log: Log, engines: list[str], folder: Path) -> None:
    for engine, workers in (("processes", 1), ("processes", 2), *((engine, 2) for engine in engines)):
        missing = [
            goal for goal in GOALS if not log.of(part="equal", engine=engine, workers=workers, goal=goal)
        ]
        if missing:
            with running_cluster(engine, folder) as cluster:
                for goal in missing:
                    key = {"part": "equal", "engine": engine, "workers": workers, "goal": goal}
                    log.add(**key, **cost(cluster, folder / "out", goal, workers))


def measure_kills(log: Log, engines: list[str], kills: int, seed: int, folder: Path) -> None:
    reference = {result["engine"]: result for result in log.of(part="equal", goal=GOALS[0])}
    sha = reference["processes"]["sha"]
    for engine in engines:
        if engine in ("dask", "ray") and not log.of(part="node", engine=engine, hit=True):
            with running_cluster(engine, folder) as cluster:
                log.add(part="node", engine=engine, **kill_node(cluster, folder / "out", sha))
    for turn, engine in enumerate(engines):
        share = len(range(turn, kills, len(engines)))
        with running_cluster(engine, folder) as cluster:
            while len(log.of(part="kill", engine=engine, hit=True)) < share:
                number = len(log.of(part="kill", engine=engine))
                rng = np.random.default_rng([seed, ENGINES.index(engine), number])
                target, work_s = TARGETS[number % 2], 0.7 * reference[engine]["wall_s"]
                outcome = kill_one(cluster, target, work_s, rng, folder / "out", sha)
                log.add(part="kill", engine=engine, number=number, **outcome)


def summary(log: Log) -> dict[str, Any]:
    equal, kills = log.of(part="equal"), log.of(part="kill", hit=True)
    return {
        "benchmark": "shards",
        "ways": len({(result["engine"], result["workers"]) for result in equal}),
        "sha256": {
            goal: sorted({result["sha"] for result in equal if result["goal"] == goal}) for goal in GOALS
        },
        "nodes": {
            result["engine"]: result["code"] == 0 and result["equal"] and not result["made_again"]
            for result in log.of(part="node", hit=True)
        },
        "kills": len(kills),
        "went_on_alone": sum(result["code"] == 0 for result in kills if result["who"] == "worker"),
        **{
            name: sum(result[name] for result in kills)
            for name in ("equal", "one_row_a_seed", "made_again", "left")
        },
        "not_gone_in_5_s": sum(result["gone_in_5_s"] is False for result in kills),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--engines", default=",".join(ENGINES), help="with commas between")
    parser.add_argument("--kills", type=int, default=20, help="that hit, of all engines together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("outputs/shards"))
    args = parser.parse_args()
    folder, engines = args.folder.resolve(), args.engines.split(",")
    folder.mkdir(parents=True, exist_ok=True)
    log = Log(folder / "log.jsonl")
    try:
        measure_costs(log, engines, folder)
        measure_kills(log, engines, args.kills, args.seed, folder)
    finally:
        kill("")
    print(json.dumps(summary(log)))


if __name__ == "__main__":
    main()
