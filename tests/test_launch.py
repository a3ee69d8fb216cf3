"""Real engines: results in order, original errors, and a retry for a job whose worker died."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.launch import LOCAL, Launch, results
from rf_exp.processes import in_order
from tests.children import is_alive, wait_until

ROOT = Path(__file__).parents[1]


def launch(engine: str, address: str | None = None, connect_s: float = 120.0) -> Launch:
    return Launch(engine, address, shard_seeds=1, connect_s=connect_s, options=None)


def own_pid() -> int:
    return os.getpid()


def report_processes(seconds: float, number: int) -> tuple[int, int, int]:
    """A job that starts a child, as a shard does: its number, its process and that of the child."""
    (child,) = in_order([own_pid], 1, 60.0)
    time.sleep(seconds)
    return number, os.getpid(), child


def run_forever(pid_file: Path) -> None:
    """A job that keeps running, as does its child; writes both process ids to `pid_file`."""
    jobs = in_order([own_pid, partial(time.sleep, 600.0)], 1, 900.0)
    draft = pid_file.with_suffix(".draft")
    draft.write_text(f"{os.getpid()} {next(jobs)}")
    draft.rename(pid_file)
    next(jobs)


def fail() -> None:
    raise StageError("not so")


def kill_worker(once: Path | None) -> str:
    """Kills its worker: always, or once if `once` is a path."""
    if once is None or not once.exists():
        if once is not None:
            once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def require(package: str) -> None:
    """Skips where a package is missing; does not import it, since Ray looks for its token at import."""
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")


@contextmanager
def dask_cluster(folder: Path) -> Iterator[Launch]:
    require("distributed")
    from distributed import LocalCluster

    cluster = LocalCluster(
        n_workers=1, threads_per_worker=1, memory_limit=0, dashboard_address=":0", local_directory=str(folder)
    )
    with cluster:
        yield launch("dask", cluster.scheduler_address)


@contextmanager
def ray_cluster(folder: Path) -> Iterator[Launch]:
    require("ray")
    with socket.socket() as free_port:
        free_port.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free_port.getsockname()[1]}"
    (token := folder / "token").write_text("0123456789abcdef" * 4)
    command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--block", "--num-cpus=1"]
    command += [f"--port={address.partition(':')[2]}", "--node-ip-address=127.0.0.1", "--disable-usage-stats"]
    command += ["--include-dashboard=false", "--object-store-memory=100000000"]
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("RAY_AUTH_MODE", "token")
        environment.setenv("RAY_AUTH_TOKEN_PATH", str(token))
        head = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            assert wait_until(lambda: is_reachable(address), 120.0)
            yield launch("ray", address)
        finally:
            head.terminate()
            head.wait(60)


def is_reachable(address: str) -> bool:
    host, _, port = address.partition(":")
    with socket.socket() as connection:
        return connection.connect_ex((host, int(port))) == 0


@contextmanager
def submitit_local(folder: Path) -> Iterator[Launch]:
    require("submitit")
    yield launch("submitit", "local")


@contextmanager
def loky(folder: Path) -> Iterator[Launch]:
    yield launch("loky")


CLUSTERS = [
    loky,
    pytest.param(dask_cluster, marks=pytest.mark.slow),
    pytest.param(ray_cluster, marks=pytest.mark.slow),
    pytest.param(submitit_local, marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize("cluster", CLUSTERS)
def test_results_are_in_order_and_jobs_of_dead_workers_are_retried(cluster, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with cluster(tmp_path) as engine:
        jobs = [
            partial(report_processes, 0.5, 0),
            partial(kill_worker, tmp_path / "died"),
            partial(report_processes, 0.0, 2),
        ]
        first, second, third = results(engine, iter(jobs), 2, tmp_path)
        assert (first[0], second, third[0]) == (0, "done", 2)
        assert not {first[1], third[1]} & {os.getpid(), first[2], third[2]}
        with pytest.raises(StageError, match=r"^not so"):
            list(results(engine, [partial(report_processes, 0.0, 0), fail], 1, tmp_path))


@pytest.mark.slow
def test_a_job_that_always_kills_its_worker_fails(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="a job has lost its worker 3 times, at last: "):
        list(results(launch("loky"), [partial(kill_worker, None)], 1, tmp_path))


@pytest.fixture(params=["heard", "ignored"])
def interrupts(request: pytest.FixtureRequest) -> Iterator[None]:
    """Ctrl-C as this process handles it, or ignored, as for background jobs of a shell script."""
    handler = signal.getsignal(signal.SIGINT)
    if request.param == "ignored":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, handler)


@pytest.mark.slow
@pytest.mark.parametrize("cluster", [loky, *CLUSTERS[2:]])  # Dask does not stop running jobs
def test_stopping_early_leaves_no_process(cluster, tmp_path, monkeypatch, interrupts) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with cluster(tmp_path) as engine:
        outcomes = results(engine, [own_pid, partial(run_forever, tmp_path / "pids")], 2, tmp_path)
        next(outcomes)
        assert wait_until((tmp_path / "pids").exists, 120.0)
        worker, child = map(int, (tmp_path / "pids").read_text().split())
        assert is_alive(worker) and is_alive(child)
        outcomes.close()
        assert wait_until(lambda: not is_alive(worker) and not is_alive(child), 30.0)


@pytest.mark.parametrize(
    ("engine", "changed", "message"),
    [
        ("slurm", {}, "unknown launch.engine 'slurm'; available: dask, loky, processes, ray, submitit"),
        ("ray", {}, "launch.engine=ray needs launch.address: HOST:6379, or auto"),
        ("loky", {"address": "tcp://a:1"}, "launch.address is given, and launch.engine=loky has none"),
        (LOCAL, {"options": {"a": 1}}, "launch.options is given, and launch.engine=processes has none"),
        ("loky", {"shard_seeds": 0}, "launch.shard_seeds is 0; it must be positive"),
        ("loky", {"connect_s": -1.0}, "launch.connect_s is -1.0; it must be positive"),
    ],
)
def test_invalid_settings_are_refused(engine, changed, message) -> None:
    settings = {"address": None, "shard_seeds": 1, "connect_s": 1.0, "options": None} | changed
    with pytest.raises(ArgumentError) as caught:
        Launch(engine, **settings)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("engine", "package"), [("dask", "distributed"), ("ray", "ray"), ("submitit", "submitit")]
)
def test_an_engine_that_is_not_installed_is_named_with_its_extra(engine, package, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # Python then reports it as missing
    with pytest.raises(ArgumentError) as caught:
        launch(engine, "auto")
    message = (
        f"launch.engine={engine} needs {package}, which is not installed; run: pip install 'rf_exp[{engine}]'"
    )
    assert str(caught.value) == message


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "package"), [("dask", "distributed"), ("ray", "ray")])
@pytest.mark.parametrize("listens", [False, True])
def test_an_address_without_an_answer_times_out(engine, package, listens, tmp_path) -> None:
    require(package)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        if listens:  # without answering
            silent.listen()
        address = f"{'tcp://' * (engine == 'dask')}127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(StageError) as caught:
            list(results(launch(engine, address, 3.0), [own_pid], 1, tmp_path))
    assert address in str(caught.value)


def test_a_missing_scheduler_and_unknown_options_are_named(tmp_path: Path) -> None:
    require("submitit")
    with pytest.raises(ArgumentError, match=r"launch.address=pbs.*AutoExecutor doesn't know any executor"):
        list(results(launch("submitit", "pbs"), [own_pid], 1, tmp_path))
    with_unknown_option = Launch("submitit", "local", 1, 1.0, {"slurm_colour": "red"})
    with pytest.raises(ArgumentError, match="Unknown argument 'colour'"):
        list(results(with_unknown_option, [own_pid], 1, tmp_path))


@pytest.mark.slow
def test_a_missing_scheduler_file_is_named(tmp_path: Path) -> None:
    require("distributed")
    with pytest.raises(StageError, match="no such file; Dask's scheduler writes it"):
        list(results(launch("dask", str(tmp_path / "scheduler.json")), [own_pid], 1, tmp_path))
