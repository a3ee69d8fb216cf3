"""Untrusted texts reach terminal, log, errors and pages as printable words."""

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
from tests.test_structure import RF_EXP_FILES, SOURCES, short_path
from tests.trust.payloads import CONTROLS, MARK

LONG = CONTROLS + "x" * 2**24 + CONTROLS  # the largest message of a policy server
LONGEST = 60_000  # characters that a command prints at most
LIFT = read_task("lift_barrier")


def assert_printable(text: str, longest: int = LONGEST, lines: bool = False) -> str:
    """Asserts printable text, without lines begun by the payload unless `lines` is true; returns it."""
    unprintable = {letter for letter in text if not (letter.isprintable() or letter == "\n")}
    assert not unprintable, sorted(map(hex, map(ord, unprintable)))
    assert len(text) <= longest
    assert lines or not any(line.startswith(f"failed: {MARK}") for line in text.splitlines())
    return text


# -- the sanitiser -----------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [CONTROLS, LONG, "\n" * 10**6 + CONTROLS, "a\tb\u00a0c \x1b"])
def test_shown_text_is_printable_and_limited_in_length(text: str) -> None:
    line = printable(text)
    assert line.isprintable() and len(line) <= 300
    assert shown(text, 5000).replace("\n", "").isprintable() and len(shown(text, 5000)) < 5100


def test_printable_text_is_unchanged() -> None:
    content = "Ärger in 3 Zügen:\n  日本, 1.5 m \N{GRINNING FACE}"
    assert shown(content) == content and printable(content.replace("\n", " ")) == content.replace("\n  ", " ")


@pytest.mark.parametrize("kind", [RfError, ArgumentError, StageError, WorkerDied, BadAnswer])
def test_an_error_with_untrusted_text_is_one_line(kind: type[RfError]) -> None:
    error = kind(f"policy server says {LONG}; start it again")
    for each in (error, pickle.loads(pickle.dumps(error)), picklable_error(error)):
        message = str(each)
        assert message.isprintable() and len(message) < LONGEST_ERROR + 100
        assert message.startswith("policy server says") and message.endswith("; start it again")


def test_a_screen_prints_only_printable_text(capsys: pytest.CaptureFixture[str]) -> None:
    grid = Table(title=CONTROLS)
    grid.add_column(CONTROLS)
    grid.add_row(CONTROLS)
    for screen in (console, error_console):
        screen.print(CONTROLS, LONG, grid)
    with Progress(CONTROLS, 2, "steps") as progress:
        progress.advance(2, note=CONTROLS)
    for output in capsys.readouterr():
        assert_printable(output, 2_000_000, lines=True)


def test_a_progress_bar_prints_only_printable_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = Screen(force_terminal=True, width=100)
    monkeypatch.setattr("rf_exp.progress.console", plain)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with Progress(CONTROLS, 2, "steps") as progress:
        progress.advance(1, note=f"\x1b]0;{MARK}\x07")
    output = capsys.readouterr().out
    assert MARK in output and "\x1b]" not in output and "\x07" not in output and "\x9b" not in output


# -- all output passes through the sanitiser -----------------------------------------------------------

EXEMPT = (
    "rf_exp/sim/vulkan.py"  # also runs without installed packages, and prints only drivers of this machine
)
OUTPUT_FUNCTIONS = {
    "print",
    "log.debug",
    "log.info",
    "log.warning",
    "log.error",
    "log.exception",
    "warnings.warn",
}
STREAMS = ("sys.stdout.", "sys.stderr.", "traceback.print", "click.")


def unsanitised_output(tree: ast.AST) -> Iterator[str]:
    """Output of a module that bypasses the screens: neither a constant nor passed through `shown`."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = ast.unparse(node.func)
        if function in OUTPUT_FUNCTIONS:
            for each in node.args:
                is_safe = isinstance(each, ast.Constant) or (
                    isinstance(each, ast.Call) and ast.unparse(each.func) in ("shown", "printable")
                )
                if not is_safe:
                    yield f"line {node.lineno}: {function}({ast.unparse(each)})"
        elif function.startswith(STREAMS) and not function.endswith((".isatty", ".fileno", ".flush")):
            yield f"line {node.lineno}: {ast.unparse(node)}"
        elif function.rpartition(".")[2] in ("Console", "Live") or function == "logging.basicConfig":
            yield f"line {node.lineno}: {ast.unparse(node)} is a screen of its own"


def test_rf_exp_prints_only_through_its_screens() -> None:
    bypasses = [
        f"{short_path(path)}, {each}"
        for path in RF_EXP_FILES
        if short_path(path) != EXEMPT
        for each in unsanitised_output(SOURCES[path])
    ]
    assert not bypasses, "\n".join(bypasses)


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
def test_unsanitised_output_is_detected(line: str) -> None:
    assert list(unsanitised_output(ast.parse(line)))


# -- all untrusted texts, and everything that is made from them -----------------------------------------


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """A command in this process: exit code, output and errors, which must be printable."""

    def call(job: Callable[[], Any], *arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rf_exp", *map(str, arguments)])
        capsys.readouterr()
        code = run_guarded(job)
        output = capsys.readouterr()
        return code, assert_printable(output.out), assert_printable(output.err)

    return call


def raise_error(error: Exception) -> Callable[[], None]:
    def job() -> None:
        raise error

    return job


def chained() -> Exception:
    """An error of a library with the payload, a StageError raised from it, as sent by a worker."""
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
def test_final_errors_of_commands_are_sanitised(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    error: Exception,
    full: str,
) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", full)
    monkeypatch.setattr("tempfile.mkdtemp", lambda **_: str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["rf_exp"])
    assert run_guarded(raise_error(error)) in (1, 2)
    errors = assert_printable(capsys.readouterr().err, 500_000, lines=full == "1")  # with the traceback
    assert MARK in errors and (full == "1" or len(errors) < LONGEST_ERROR + 200)
    if (tmp_path / "error.log").exists():
        assert_printable((tmp_path / "error.log").read_text("utf-8"), 500_000, lines=True)


def closes(socket: ServerConnection) -> None:
    socket.close(1011, CONTROLS.encode("utf-8", "replace").decode()[:40])


def sends(*messages: bytes | str) -> Callable[[ServerConnection], None]:
    def converse(socket: ServerConnection) -> None:
        socket.send(messages[0])
        for message in messages[1:]:
            socket.recv()
            socket.send(message)

    return converse


VALID = CONTROLS.encode("utf-8", "replace").decode()  # valid as UTF-8
FULL = VALID + "x" * (2**24 - 2 * len(VALID.encode()) - 100)


@pytest.mark.parametrize(
    "converse",
    [
        sends(VALID), sends(VALID + FULL), sends(FULL), sends("\n" * (2**24 - 9) + VALID),
        sends(pack({}), FULL), sends(pack({VALID: 1, FULL: 2})), sends(pack({}), pack({VALID: 1, FULL: 2})),
        sends(pack({}), VALID.encode()), sends(pack({}), pack({b"__ndarray__": True, b"dtype": FULL})),
        sends(pack({}), pack({"actions": VALID})), sends(pack({}), pack({"actions": [[FULL]]})), closes,
    ],
)  # fmt: skip
def test_texts_of_a_policy_server_are_sanitised(run: Run, converse: Any) -> None:
    def job() -> None:
        with server(converse) as address:
            remote = Remote(address, 20.0, 20.0)
            try:
                validate_chunk(remote.act({"qpos": np.zeros(3)}), 2)
            except ValueError as error:
                raise StageError(*error.args) from error

    code, _, errors = run(job)
    assert code == 1 and len(errors) < LONGEST_ERROR + 200


def test_texts_of_a_handshake_are_sanitised(run: Run) -> None:
    def refuses(connection: Any, request: Any) -> Any:
        response = connection.respond(403, VALID)
        response.reason_phrase = f"{MARK} \x1b[2J"
        return response

    def job() -> None:
        with server(closes, process_request=refuses) as address:
            Remote(address, 20.0, 20.0)

    assert run(job)[0] == 1


def make_orders() -> None:
    """A factory of policies."""
    raise RuntimeError(LONG)


@pytest.mark.parametrize("name", [f"{__name__}:make_orders", f"{__name__}:{MARK}", f"{CONTROLS}:x"])
def test_texts_of_a_foreign_policy_are_sanitised(run: Run, name: str) -> None:
    assert run(lambda: make_policy(name))[0] in (1, 2)


@pytest.mark.parametrize(
    "answer",
    [
        CONTROLS, LONG, json.dumps({CONTROLS: 1}), json.dumps({"Subgoals": {CONTROLS: "hold"}}),
        json.dumps({"Subgoals": {"Agent_1": CONTROLS}}),
        json.dumps({"Subgoals": {"Agent_1": [CONTROLS]}, "Constraints": {CONTROLS: []}}),
        json.dumps({"Subgoals": {}, "Constraints": {"Logical": [{"Agents": [CONTROLS], "Constraint": "x"}]}}),
        json.dumps({"Subgoals": {}, "Constraints": {"Logical": [{CONTROLS: CONTROLS, "Constraint": "x"}]}}),
    ],
)  # fmt: skip
def test_texts_of_a_language_model_are_sanitised(run: Run, answer: str) -> None:
    assert run(lambda: from_json(answer, LIFT) and None)[0] in (0, 1)


def with_controls(value: Any) -> Any:
    """Attributes with the payload in every text, and in additional keys."""
    if isinstance(value, dict):
        return {f"{CONTROLS}{key}": with_controls(each) for key, each in value.items()} | {
            key: with_controls(each) for key, each in value.items()
        }
    if isinstance(value, list):
        return [with_controls(each) for each in value]
    return CONTROLS + "x" * 20_000 if isinstance(value, str) else value


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store with the payload in all attributes except those that make it a store."""
    path = store_of(tmp_path / "store.zarr", range(2))
    group = zarr.open_group(path, mode="r+")
    required = ("format", "agents", "height", "width", "control_hz", "cameras", "objects", "labels", "depth")
    attributes = {
        key: value if key in required else with_controls(value) for key, value in dict(group.attrs).items()
    }
    surrogates = json.dumps(attributes)
    group.attrs.put(json.loads(surrogates))
    return path


@pytest.mark.slow
def test_texts_of_a_store_are_sanitised(run: Run, store: Path, tmp_path: Path) -> None:
    results = [
        run(data, "summary", store),
        run(data, "summary", "--json", store),
        run(data, "validate", store),
        run(data, "merge", store, store, "--to", tmp_path / "merged.zarr"),
        run(data, "export", store, tmp_path / "exported", "--format", "lerobot", "--pictures", "png"),
        run(rescue.main, store, "--dry-run"),
        run(lambda: rescue.rescue(store)),
    ]
    assert results[0][0] == 0 and MARK in results[0][1]
    for page in [*tmp_path.rglob("*.md")]:
        assert_printable(page.read_text("utf-8"), 2_000_000)


@pytest.mark.slow
def test_texts_of_a_damaged_store_are_sanitised(run: Run, store: Path) -> None:
    for content in (b"", VALID.encode(), b"{" + VALID.encode(), json.dumps({CONTROLS: LONG}).encode()):
        (store / "zarr.json").write_bytes(content)
        for arguments in (("summary", store), ("validate", store)):
            assert run(data, *arguments)[0] == 1
        assert run(rescue.main, store)[0] == 1


@contextmanager
def folder_named(parent: Path, name: str) -> Iterator[Path]:
    folder = parent / name
    folder.mkdir()
    yield folder


def test_file_names_are_sanitised(run: Run, tmp_path: Path) -> None:
    name = f"{MARK}\x1b[2J\x1b]0;x\x07\u202e\x9b31m.zarr"
    with folder_named(tmp_path, name) as folder:
        assert run(data, "summary", folder)[0] == 1
        assert run(data, "validate", folder)[0] == 1
        assert run(rescue.main, folder)[0] == 1
        assert run(lambda: tables(["--out", str(folder)]) and None)[0] == 0  # it has reported why it failed
    good = store_of(tmp_path / f"2{name}", range(1))
    assert run(data, "summary", good)[0] == 0 and run(data, "validate", good)[0] == 0


@pytest.mark.slow
def test_texts_of_rows_are_sanitised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    account = Account(unmet=(Unmet(CONTROLS, unit=CONTROLS),), ended=LONG[:50_000])
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
    for output in capsys.readouterr():
        assert_printable(output)
    written = [*tmp_path.rglob("tables/*.md"), *tmp_path.rglob("*.tex"), tmp_path / "report.html"]
    assert len(written) > 8
    for path in written:
        assert_printable(path.read_text("utf-8"), 10**7, lines=path.suffix == ".html")  # in folded sections
    assert MARK in written[-1].read_text("utf-8")


@pytest.mark.parametrize("key", ["task", "constraints", "brain", "version", "generator", "commit"])
def test_labels_of_rows_are_single_words(tmp_path: Path, key: str, run: Run) -> None:
    with pytest.raises(ArgumentError, match=f"{key} of a GenerationRow is .*expected one word"):
        replace(generation("lift_barrier", "full", 1, 0)[0], **{key: CONTROLS})


def lift_barrier() -> dict[str, Any]:
    """The content of the task file."""
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "task" / "lift_barrier.yaml"))
    return node["lift_barrier"]


@pytest.mark.parametrize("key", ["title", "description", "target_condition", "code"])
@pytest.mark.parametrize(
    "words", [CONTROLS, "\ud800", "x" * 3000, "${oc.env:HOME}", "see ${hydra:runtime.cwd}"]
)
def test_a_task_with_unprintable_texts_is_refused(run: Run, key: str, words: str, tmp_path: Path) -> None:
    node = lift_barrier() | {key: words}
    code, _, errors = run(lambda: load_task("lift_barrier", node) and None)
    assert code == 2 and f"task 'lift_barrier': field {key} is" in errors
    assert os.environ["HOME"] not in errors


@pytest.mark.slow
@pytest.mark.parametrize("key", ["title", "objects.barrier.x_m", "step_limit"])
@pytest.mark.parametrize("value", ["${oc.env:HOME}", "${demos}"])
def test_tasks_are_not_interpolated_from_the_environment(
    command: Any, tmp_path: Path, key: str, value: str
) -> None:
    result = command(f"task.lift_barrier.{key}='{value}'", "stages=[report]", f"out={tmp_path}")
    assert result.returncode == 2 and os.environ["HOME"] not in result.stderr.replace(str(tmp_path), "")
    assert f"task 'lift_barrier': field {key} is '{value}'; nothing is looked up for a task" in result.stderr


@pytest.mark.parametrize("field", ["objects", "cameras", "success"])
@pytest.mark.parametrize("name", [CONTROLS, "../../x", "a|b", "x" * 100, 3, ""])
def test_invalid_names_in_a_task_are_refused(run: Run, field: str, name: Any) -> None:
    node = lift_barrier()
    node[field][name] = next(iter(node[field].values()))
    code, _, errors = run(lambda: load_task("lift_barrier", node) and None)
    assert code == 2 and f"in field {field}; expected a name" in errors


def test_all_tasks_of_the_suite_have_printable_texts() -> None:
    assert len(TASKS) == len({read_task(name).title for name in TASKS})
    assert ablation.configured() and isinstance(console, Console)
