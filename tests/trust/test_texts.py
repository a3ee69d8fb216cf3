"""What strangers say reaches terminal, log, error and page as words on lines that can be read."""

import ast
import json
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Table
from websockets.sync.server import ServerConnection

from rf_exp import ablation, rescue
from rf_exp.ablation import append_row
from rf_exp.ablation.__main__ import main as tables
from rf_exp.client import pack, validate_chunk
from rf_exp.command import run_guarded
from rf_exp.data.__main__ import main as data
from rf_exp.datagen.brain import BadAnswer, from_json
from rf_exp.errors import ArgumentError, RfError, StageError, WorkerDied, picklable_error
from rf_exp.findings import Account, Unmet
from rf_exp.policy import make_policy
from rf_exp.policy.foreign.remote import Remote
from rf_exp.progress import Progress, Screen, console, error_console
from rf_exp.tasks import load_task
from rf_exp.texts import LONGEST_ERROR, printable, shown
from tests.ablation.conftest import evaluation, generation
from tests.conftest import CONF, TASKS, read_task
from tests.policy.others import server
from tests.test_data import store_of
from tests.test_structure import HOUSE, SOURCES, named
from tests.trust.payloads import MARK, ORDERS

LONG = ORDERS + "x" * 2**24 + ORDERS  # as much as a message may have
LONGEST = 60_000  # characters of what a command prints
LIFT = read_task("lift_barrier")


def expect_words(text: str, longest: int = LONGEST, lines: bool = False) -> str:
    """Printable lines, none of which is a stranger's own, unless he may have some."""
    odd = {letter for letter in text if not (letter.isprintable() or letter == "\n")}
    assert not odd, sorted(map(hex, map(ord, odd)))
    assert len(text) <= longest
    assert lines or not any(line.startswith(f"failed: {MARK}") for line in text.splitlines())
    return text


# -- the sanitiser -----------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [ORDERS, LONG, "\n" * 10**6 + ORDERS, "a\tb\u00a0c \x1b"])
def test_what_is_shown_is_printable_and_no_longer_than_it_may_be(text: str) -> None:
    line = printable(text)
    assert line.isprintable() and len(line) <= 300
    assert shown(text, 5000).replace("\n", "").isprintable() and len(shown(text, 5000)) < 5100


def test_what_can_be_shown_stays_as_it_is() -> None:
    said = "Ärger in 3 Zügen:\n  日本, 1.5 m \N{GRINNING FACE}"
    assert shown(said) == said and printable(said.replace("\n", " ")) == said.replace("\n  ", " ")


@pytest.mark.parametrize("kind", [RfError, ArgumentError, StageError, WorkerDied, BadAnswer])
def test_an_error_is_one_line_whoever_is_repeated_in_it(kind: type[RfError]) -> None:
    error = kind(f"policy server says {LONG}; start it again")
    for each in (error, pickle.loads(pickle.dumps(error)), picklable_error(error)):
        said = str(each)
        assert said.isprintable() and len(said) < LONGEST_ERROR + 100
        assert said.startswith("policy server says") and said.endswith("; start it again")


def test_a_screen_shows_words_whatever_they_are_part_of(capsys: pytest.CaptureFixture[str]) -> None:
    grid = Table(title=ORDERS)
    grid.add_column(ORDERS)
    grid.add_row(ORDERS)
    for screen in (console, error_console):
        screen.print(ORDERS, LONG, grid)
    with Progress(ORDERS, 2, "steps") as progress:
        progress.advance(2, note=ORDERS)
    for said in capsys.readouterr():
        expect_words(said, 2_000_000, lines=True)


def test_a_bar_shows_words(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    plain = Screen(force_terminal=True, width=100)
    monkeypatch.setattr("rf_exp.progress.console", plain)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with Progress(ORDERS, 2, "steps") as progress:
        progress.advance(1, note=f"\x1b]0;{MARK}\x07")
    said = capsys.readouterr().out
    assert MARK in said and "\x1b]" not in said and "\x07" not in said and "\x9b" not in said


# -- the law: nothing is said but through it -----------------------------------------------------------

ALONE = "rf_exp/sim/vulkan.py"  # also runs where nothing is installed; it tells of this machine's drivers
SPOKEN = {"print", "log.debug", "log.info", "log.warning", "log.error", "log.exception", "warnings.warn"}
STREAMS = ("sys.stdout.", "sys.stderr.", "traceback.print", "click.")


def said_past(tree: ast.AST) -> Iterator[str]:
    """Where a module speaks past the screens: what is printed or logged is no constant, and not `shown`."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in SPOKEN:
            for each in node.args:
                words = isinstance(each, ast.Constant) or (
                    isinstance(each, ast.Call) and ast.unparse(each.func) in ("shown", "printable")
                )
                if not words:
                    yield f"line {node.lineno}: {called}({ast.unparse(each)})"
        elif called.startswith(STREAMS) and not called.endswith((".isatty", ".fileno", ".flush")):
            yield f"line {node.lineno}: {ast.unparse(node)}"
        elif called.rpartition(".")[2] in ("Console", "Live") or called == "logging.basicConfig":
            yield f"line {node.lineno}: {ast.unparse(node)} is a screen of its own"


def test_the_house_speaks_through_its_screens() -> None:
    wrong = [
        f"{named(path)}, {each}"
        for path in HOUSE
        if named(path) != ALONE
        for each in said_past(SOURCES[path])
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "line",
    [
        "print(text)",
        "print(f'{x}')",
        "log.warning(x)",
        "sys.stderr.write(x)",
        "Console()",
        "rich.console.Console()",
    ],
)
def test_the_law_sees_who_does_not(line: str) -> None:
    assert list(said_past(ast.parse(line)))


# -- everything that a stranger can say, and all that comes of it ---------------------------------------


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """A command in this process: exit code, output, errors; the two are words."""

    def call(job: Callable[[], Any], *arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp", *map(str, arguments)])
        capsys.readouterr()
        code = run_guarded(job)
        said = capsys.readouterr()
        return code, expect_words(said.out), expect_words(said.err)

    return call


def raising(error: Exception) -> Callable[[], None]:
    def job() -> None:
        raise error

    return job


def chained() -> Exception:
    """An error of a library that repeats a stranger, ours that is raised from it, and what a worker tells."""
    try:
        try:
            raise ValueError(LONG)
        except ValueError as error:
            raise StageError(f"the server says {error}") from error
    except StageError as error:
        return picklable_error(error)


@pytest.mark.slow
@pytest.mark.parametrize("full", ["0", "1"])
@pytest.mark.parametrize(
    "error", [StageError(LONG), ArgumentError(LONG), ValueError(LONG), OSError(2, LONG, LONG), chained()]
)
def test_no_command_ends_with_a_strangers_orders(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    error: Exception,
    full: str,
) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", full)
    monkeypatch.setattr("tempfile.mkdtemp", lambda **_: str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["rf_exp"])
    assert run_guarded(raising(error)) in (1, 2)
    told = expect_words(capsys.readouterr().err, 500_000, lines=full == "1")  # with the traceback
    assert MARK in told and (full == "1" or len(told) < LONGEST_ERROR + 200)
    if (tmp_path / "error.log").exists():
        expect_words((tmp_path / "error.log").read_text("utf-8"), 500_000, lines=True)


def closes(socket: ServerConnection) -> None:
    socket.close(1011, ORDERS.encode("utf-8", "replace").decode()[:40])


def sends(*messages: bytes | str) -> Callable[[ServerConnection], None]:
    def converse(socket: ServerConnection) -> None:
        socket.send(messages[0])
        for message in messages[1:]:
            socket.recv()
            socket.send(message)

    return converse


VALID = ORDERS.encode("utf-8", "replace").decode()  # what can be sent as UTF-8
MOST = VALID + "x" * (2**24 - 2 * len(VALID.encode()) - 100)


@pytest.mark.parametrize(
    "converse",
    [
        sends(VALID), sends(VALID + MOST), sends(MOST), sends("\n" * (2**24 - 9) + VALID),
        sends(pack({}), MOST), sends(pack({VALID: 1, MOST: 2})), sends(pack({}), pack({VALID: 1, MOST: 2})),
        sends(pack({}), VALID.encode()), sends(pack({}), pack({b"__ndarray__": True, b"dtype": MOST})),
        sends(pack({}), pack({"actions": VALID})), sends(pack({}), pack({"actions": [[MOST]]})), closes,
    ],
)  # fmt: skip
def test_a_policy_server_gives_no_orders(run: Run, converse: Any) -> None:
    def job() -> None:
        with server(converse) as address:
            remote = Remote(address, 20.0, 20.0)
            try:
                validate_chunk(remote.act({"qpos": np.zeros(3)}), 2)
            except ValueError as error:
                raise StageError(*error.args) from error

    code, _, told = run(job)
    assert code == 1 and len(told) < LONGEST_ERROR + 200


def test_a_handshake_gives_no_orders(run: Run) -> None:
    def refuses(connection: Any, request: Any) -> Any:
        response = connection.respond(403, VALID)
        response.reason_phrase = f"{MARK} \x1b[2J"
        return response

    def job() -> None:
        with server(closes, process_request=refuses) as address:
            Remote(address, 20.0, 20.0)

    assert run(job)[0] == 1


def make_orders() -> None:
    """A factory of a policy."""
    raise RuntimeError(LONG)


@pytest.mark.parametrize("name", [f"{__name__}:make_orders", f"{__name__}:{MARK}", f"{ORDERS}:x"])
def test_a_policy_of_others_gives_no_orders(run: Run, name: str) -> None:
    assert run(lambda: make_policy(name))[0] in (1, 2)


@pytest.mark.parametrize(
    "answer",
    [
        ORDERS, LONG, json.dumps({ORDERS: 1}), json.dumps({"Subgoals": {ORDERS: "hold"}}),
        json.dumps({"Subgoals": {"Agent_1": ORDERS}}),
        json.dumps({"Subgoals": {"Agent_1": [ORDERS]}, "Constraints": {ORDERS: []}}),
        json.dumps({"Subgoals": {}, "Constraints": {"Logical": [{"Agents": [ORDERS], "Constraint": "x"}]}}),
        json.dumps({"Subgoals": {}, "Constraints": {"Logical": [{ORDERS: ORDERS, "Constraint": "x"}]}}),
    ],
)  # fmt: skip
def test_a_model_gives_no_orders(run: Run, answer: str) -> None:
    assert run(lambda: from_json(answer, LIFT) and None)[0] in (0, 1)


def told_by(value: Any) -> Any:
    """Attributes in which every text, and every name that may be any, is a stranger's."""
    if isinstance(value, dict):
        return {f"{ORDERS}{key}": told_by(each) for key, each in value.items()} | {
            key: told_by(each) for key, each in value.items()
        }
    if isinstance(value, list):
        return [told_by(each) for each in value]
    return ORDERS + "x" * 20_000 if isinstance(value, str) else value


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store in whose attributes all words are a stranger's, but for those without which it is none."""
    path = store_of(tmp_path / "store.zarr", range(2))
    group = zarr.open_group(path, mode="r+")
    kept = ("format", "agents", "height", "width", "control_hz", "cameras", "objects", "labels", "depth")
    attributes = {key: value if key in kept else told_by(value) for key, value in dict(group.attrs).items()}
    surrogates = json.dumps(attributes)
    group.attrs.put(json.loads(surrogates))
    return path


@pytest.mark.slow
def test_a_store_gives_no_orders(run: Run, store: Path, tmp_path: Path) -> None:
    said = [
        run(data, "summary", store),
        run(data, "summary", "--json", store),
        run(data, "validate", store),
        run(data, "merge", store, store, "--to", tmp_path / "merged.zarr"),
        run(data, "export", store, tmp_path / "exported", "--format", "lerobot", "--pictures", "png"),
        run(rescue.main, store, "--dry-run"),
        run(lambda: rescue.rescue(store)),
    ]
    assert said[0][0] == 0 and MARK in said[0][1]
    for page in [*tmp_path.rglob("*.md")]:
        expect_words(page.read_text("utf-8"), 2_000_000)


@pytest.mark.slow
def test_what_damages_a_store_gives_no_orders(run: Run, store: Path) -> None:
    for kept in (b"", VALID.encode(), b"{" + VALID.encode(), json.dumps({ORDERS: LONG}).encode()):
        (store / "zarr.json").write_bytes(kept)
        for arguments in (("summary", store), ("validate", store)):
            assert run(data, *arguments)[0] == 1
        assert run(rescue.main, store)[0] == 1


@contextmanager
def folder_named(parent: Path, name: str) -> Iterator[Path]:
    folder = parent / name
    folder.mkdir()
    yield folder


def test_the_name_of_a_file_gives_no_orders(run: Run, tmp_path: Path) -> None:
    name = f"{MARK}\x1b[2J\x1b]0;x\x07\u202e\x9b31m.zarr"
    with folder_named(tmp_path, name) as folder:
        assert run(data, "summary", folder)[0] == 1
        assert run(data, "validate", folder)[0] == 1
        assert run(rescue.main, folder)[0] == 1
        assert run(lambda: tables(["--out", str(folder)]) and None)[0] == 0  # it has said why it has failed
    good = store_of(tmp_path / f"2{name}", range(1))
    assert run(data, "summary", good)[0] == 0 and run(data, "validate", good)[0] == 0


@pytest.mark.slow
def test_rows_give_no_orders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    account = Account(unmet=(Unmet(ORDERS, unit=ORDERS),), ended=LONG[:50_000])
    rows = [replace(row, account=account) for row in generation("lift_barrier", "full", 2, 2)]
    for row in rows:
        append_row(tmp_path / "results/generate/lift_barrier/full.jsonl", row)
    for row in evaluation("lift_barrier", "separate_local", 50, 2, 2):
        append_row(
            tmp_path / "results/evaluate/lift_barrier/separate_local/full-fast-50.jsonl",
            replace(row, account=account),
        )
    for folder, name in (("runs/x/.hydra", "config.yaml"), ("policies/a/b", "curves.csv")):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / name).write_bytes(VALID.encode())
    assert tables(["--out", str(tmp_path)]) == 0
    for said in capsys.readouterr():
        expect_words(said)
    written = [*tmp_path.rglob("tables/*.md"), *tmp_path.rglob("*.tex"), tmp_path / "report.html"]
    assert len(written) > 8
    for path in written:
        expect_words(path.read_text("utf-8"), 10**7, lines=path.suffix == ".html")  # in what is folded away
    assert MARK in written[-1].read_text("utf-8")


@pytest.mark.parametrize("key", ["task", "constraints", "brain", "version", "generator", "commit"])
def test_what_rows_are_called_is_a_word(tmp_path: Path, key: str, run: Run) -> None:
    with pytest.raises(ArgumentError, match=f"{key} of a GenerationRow is .*expected one word"):
        replace(generation("lift_barrier", "full", 1, 0)[0], **{key: ORDERS})


def lift_barrier() -> dict[str, Any]:
    """What its file says."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / "lift_barrier.yaml"))
    return node["lift_barrier"]


@pytest.mark.parametrize("key", ["title", "description", "target_condition", "code"])
@pytest.mark.parametrize(
    "words", [ORDERS, "\ud800", "x" * 3000, "${oc.env:HOME}", "see ${hydra:runtime.cwd}"]
)
def test_a_task_whose_words_cannot_be_shown_is_refused(
    run: Run, key: str, words: str, tmp_path: Path
) -> None:
    node = lift_barrier() | {key: words}
    code, _, told = run(lambda: load_task("lift_barrier", node) and None)
    assert code == 2 and f"task 'lift_barrier': field {key} is" in told
    assert os.environ["HOME"] not in told


@pytest.mark.slow
@pytest.mark.parametrize("key", ["title", "objects.barrier.x_m", "step_limit"])
@pytest.mark.parametrize("value", ["${oc.env:HOME}", "${demos}"])
def test_no_task_is_told_by_the_environment(command: Any, tmp_path: Path, key: str, value: str) -> None:
    done = command(f"task.lift_barrier.{key}='{value}'", "stages=[report]", f"out={tmp_path}")
    assert done.returncode == 2 and os.environ["HOME"] not in done.stderr.replace(str(tmp_path), "")
    assert f"task 'lift_barrier': field {key} is '{value}'; nothing is looked up for a task" in done.stderr


@pytest.mark.parametrize("at", ["objects", "cameras", "success"])
@pytest.mark.parametrize("name", [ORDERS, "../../x", "a|b", "x" * 100, 3, ""])
def test_what_a_task_calls_its_things_is_a_name(run: Run, at: str, name: Any) -> None:
    node = lift_barrier()
    node[at][name] = next(iter(node[at].values()))
    code, _, told = run(lambda: load_task("lift_barrier", node) and None)
    assert code == 2 and f"in field {at}; expected a name" in told


def test_every_task_of_the_suite_has_words_that_can_be_shown() -> None:
    assert len(TASKS) == len({read_task(name).title for name in TASKS})
    assert ablation.configured() and isinstance(console, Console)
