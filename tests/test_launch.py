"""Engines, real ones: results in order, errors as they were, and another try for a job whose worker died."""

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
from tests.children import alive, until

ROOT = Path(__file__).parents[1]


def launch(engine: str, address: str | None = None, connect_s: float = 120.0) -> Launch:
    return Launch(engine, address, shard_seeds=1, connect_s=connect_s, options=None)


def process() -> int:
    return os.getpid()


def who(seconds: float, number: int) -> tuple[int, int, int]:
    """A job that, as a shard does, has a child; its number, its process and that of the child."""
    (child,) = in_order([process], 1, 60.0)
    time.sleep(seconds)
    return number, os.getpid(), child


def stays(told: Path) -> None:
    """A job that goes on, as its child does; `told` becomes its process and that of the child."""
    made = in_order([process, partial(time.sleep, 600.0)], 1, 900.0)
    draft = told.with_suffix(".draft")
    draft.write_text(f"{os.getpid()} {next(made)}")
    draft.rename(told)
    next(made)


def wrong() -> None:
    raise StageError("not so")


def dies(once: Path | None) -> str:
    """Kills its worker, always or once."""
    if once is None or not once.exists():
        if once is not None:
            once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def needs(package: str) -> None:
    """Skips where a package is missing, and imports none: Ray reads at that whether it has a token."""
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")


@contextmanager
def dask_cluster(folder: Path) -> Iterator[Launch]:
    needs("distributed")
    from distributed import LocalCluster

    made = LocalCluster(
        n_workers=1, threads_per_worker=1, memory_limit=0, dashboard_address=":0", local_directory=str(folder)
    )
    with made:
        yield launch("dask", made.scheduler_address)


@contextmanager
def ray_cluster(folder: Path) -> Iterator[Launch]:
    needs("ray")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    (token := folder / "token").write_text("0123456789abcdef" * 4)
    command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--block", "--num-cpus=1"]
    command += [f"--port={address.partition(':')[2]}", "--node-ip-address=127.0.0.1", "--disable-usage-stats"]
    command += ["--include-dashboard=false", "--object-store-memory=100000000"]
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("RAY_AUTH_MODE", "token")
        environment.setenv("RAY_AUTH_TOKEN_PATH", str(token))
        head = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            assert until(lambda: knock(address), 120.0)
            yield launch("ray", address)
        finally:
            head.terminate()
            head.wait(60)


def knock(address: str) -> bool:
    host, _, port = address.partition(":")
    with socket.socket() as one:
        return one.connect_ex((host, int(port))) == 0


@contextmanager
def submitit_here(folder: Path) -> Iterator[Launch]:
    needs("submitit")
    yield launch("submitit", "local")


@contextmanager
def loky(folder: Path) -> Iterator[Launch]:
    yield launch("loky")


CLUSTERS = [
    loky,
    pytest.param(dask_cluster, marks=pytest.mark.slow),
    pytest.param(ray_cluster, marks=pytest.mark.slow),
    pytest.param(submitit_here, marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize("cluster", CLUSTERS)
def test_an_engine_does_jobs_in_order_and_again_when_a_worker_dies(cluster, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with cluster(tmp_path) as to:
        jobs = [partial(who, 0.5, 0), partial(dies, tmp_path / "died"), partial(who, 0.0, 2)]
        first, second, third = results(to, iter(jobs), 2, tmp_path)
        assert (first[0], second, third[0]) == (0, "done", 2)
        assert not {first[1], third[1]} & {os.getpid(), first[2], third[2]}
        with pytest.raises(StageError, match=r"^not so"):
            list(results(to, [partial(who, 0.0, 0), wrong], 1, tmp_path))


@pytest.mark.slow
def test_a_job_that_always_loses_its_worker_is_given_up(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="a job has lost its worker 3 times, at last: "):
        list(results(launch("loky"), [partial(dies, None)], 1, tmp_path))


@pytest.fixture(params=["heard", "ignored"])
def interrupts(request: pytest.FixtureRequest) -> Iterator[None]:
    """Ctrl-C as this process was told it, or ignored, as in the background of a shell's script."""
    told = signal.getsignal(signal.SIGINT)
    if request.param == "ignored":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, told)


@pytest.mark.slow
@pytest.mark.parametrize("cluster", [loky, *CLUSTERS[2:]])  # Dask lets a job that has begun go on
def test_who_stops_early_leaves_no_process(cluster, tmp_path, monkeypatch, interrupts) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with cluster(tmp_path) as to:
        made = results(to, [process, partial(stays, tmp_path / "pids")], 2, tmp_path)
        next(made)
        assert until((tmp_path / "pids").exists, 120.0)
        worker, child = map(int, (tmp_path / "pids").read_text().split())
        assert alive(worker) and alive(child)
        made.close()
        assert until(lambda: not alive(worker) and not alive(child), 30.0)


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
def test_what_cannot_be_is_refused(engine, changed, message) -> None:
    given = {"address": None, "shard_seeds": 1, "connect_s": 1.0, "options": None} | changed
    with pytest.raises(ArgumentError) as caught:
        Launch(engine, **given)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("engine", "package"), [("dask", "distributed"), ("ray", "ray"), ("submitit", "submitit")]
)
def test_an_engine_that_is_not_installed_is_named_with_its_extra(engine, package, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # Python then takes it for missing
    with pytest.raises(ArgumentError) as caught:
        launch(engine, "auto")
    said = (
        f"launch.engine={engine} needs {package}, which is not installed; run: pip install 'rf_exp[{engine}]'"
    )
    assert str(caught.value) == said


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "package"), [("dask", "distributed"), ("ray", "ray")])
@pytest.mark.parametrize("listens", [False, True])
def test_an_address_where_nobody_answers_fails_in_time(engine, package, listens, tmp_path) -> None:
    needs(package)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        if listens:  # and says nothing
            silent.listen()
        address = f"{'tcp://' * (engine == 'dask')}127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(StageError) as caught:
            list(results(launch(engine, address, 3.0), [process], 1, tmp_path))
    assert address in str(caught.value)


def test_no_slurm_and_options_that_it_does_not_have_are_said(tmp_path: Path) -> None:
    needs("submitit")
    with pytest.raises(ArgumentError, match=r"launch.address=pbs.*AutoExecutor doesn't know any executor"):
        list(results(launch("submitit", "pbs"), [process], 1, tmp_path))
    wrong = Launch("submitit", "local", 1, 1.0, {"slurm_colour": "red"})
    with pytest.raises(ArgumentError, match="Unknown argument 'colour'"):
        list(results(wrong, [process], 1, tmp_path))


@pytest.mark.slow
def test_a_scheduler_s_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    needs("distributed")
    with pytest.raises(StageError, match="no such file; Dask's scheduler writes it"):
        list(results(launch("dask", str(tmp_path / "scheduler.json")), [process], 1, tmp_path))
