"""Crash safety of commands that write: kills them at every write and at random moments.

    python benchmarks/writes.py [--commands merge,export-lerobot,...] [--every 1] [--kills 30] [--folder DIR]

Merge, all exports, import, rescue, release and publish take the data that `benchmarks/kills.py` makes once in
DIR/whole. Each command is ended by SIGKILL just before its first write below its folder, before the second
(`--every`: not before each), ... and at a number of random moments; after every kill the same command is run
again. A write is opening a file for writing, or creating, renaming or removing anything. Checked each time:
the kill has left the inputs unchanged and the outputs either complete or absent; the repeated command gives
the bytes of an undisturbed one; and it leaves no temporary file. The last line is JSON: for every command the
kills that hit it at work, and how many of them passed all of these checks.
"""

import argparse
import hashlib
import json
import os
import runpy
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
HANG_LIMIT_S = 300  # a command that takes longer is ended
SCENES = 3  # of the experiment that kills.py makes
CHANGE_EVENTS = {  # audit event -> argument indices of the changed path and of its folder's descriptor
    "os.mkdir": (0, 2),
    "os.rename": (1, 3),
    "os.remove": (0, 1),
    "os.rmdir": (0, 1),
    "os.link": (1, 3),
    "os.symlink": (1, 2),
    "os.truncate": (0, None),
}
WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC

Content = dict[str, str]  # path -> digest of its bytes


@dataclass(frozen=True)
class Command:
    """A command as a function, with its inputs and outputs."""

    run: Callable[[Path], object]  # takes the folder below which it writes
    prepare: Callable[[Path], object] = lambda folder: None  # fills the folder beforehand
    inputs: tuple[Path, ...] = ()  # only read
    atomic_outputs: tuple[
        str, ...
    ] = ()  # files and folders that must be in their old or their new state, never in between
    # Further defects of the folder after a kill, in words; empty for none.
    other_defects: Callable[[Path], str] = lambda folder: ""


@dataclass
class Trials:
    """Results of the kills of one command."""

    kills: int = 0
    writes: int = 0
    defects: list[str] = field(default_factory=list)

    @property
    def row(self) -> dict[str, Any]:
        return {"writes": self.writes, "kills": self.kills, "right": self.kills - len(self.defects)}


def in_child(
    job: Callable[[], object], below: Path, dies_at: int = 0, dies_after_s: float = 0.0
) -> int | None:
    """Runs a job in a forked child; returns the number of its writes below a folder, None if it was killed.

    It is killed just before write number `dies_at`, the first being 1, or after `dies_after_s`. An exception
    is printed and counts as an end.
    """
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        write_count = 0

        def count(event: str, args: tuple[Any, ...]) -> None:
            nonlocal write_count
            if writes_below(str(below), event, args):
                write_count += 1
                if write_count == dies_at:
                    os.kill(os.getpid(), signal.SIGKILL)

        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.fsync = lambda _: None  # data in the page cache survives a kill: no need to wait for a disk
            signal.alarm(HANG_LIMIT_S)
            sys.addaudithook(count)
            job()
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
        finally:
            os.write(write, str(write_count).encode())
            os._exit(0)
    os.close(write)
    if dies_after_s:
        time.sleep(dies_after_s)
        os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    with open(read, "rb") as pipe:
        output = pipe.read()
    return int(output) if output else None


def writes_below(below: str, event: str, args: tuple[Any, ...]) -> bool:
    """Whether an audit event of Python is a change below a folder."""
    if event == "open":
        path, _, flags = args
        return isinstance(flags, int) and bool(flags & WRITE_FLAGS) and str(path).startswith(below)
    if event not in CHANGE_EVENTS:
        return False
    path_index, folder_index = CHANGE_EVENTS[event]
    path = (
        os.fsdecode(args[path_index])
        if not isinstance(args[path_index], int)
        else f"/proc/self/fd/{args[path_index]}"
    )
    if folder_index is not None and args[folder_index] != -1:
        path = os.path.join(os.readlink(f"/proc/self/fd/{args[folder_index]}"), path)
    return path.startswith(below)


def content(folder: Path) -> Content:
    """The content of a folder without lock files, which contain their holders."""
    contents: Content = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() and not any(path.iterdir()):
            contents[name] = "empty folder"
        elif path.is_file() and path.suffix != ".lock":
            contents[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return contents


def content_below(contents: Content, name: str) -> Content:
    """The part of a content that is a file or lies in a folder."""
    return {path: digest for path, digest in contents.items() if path == name or path.startswith(f"{name}/")}


def killed(
    command: Command, folder: Path, every: int = 1, last: int | None = None, moments: int = 0, seed: int = 0
) -> Trials:
    """Kills a command before every `every`-th of its `last` (default: all) writes, and at random moments."""
    rng, trials = np.random.default_rng(seed), Trials()
    inputs = [content(path) for path in command.inputs]
    before, reference = content(_fresh(command, folder / "killed")), _fresh(command, folder / "whole")
    began = time.monotonic()
    writes = in_child(lambda: command.run(reference), reference)
    run_s = time.monotonic() - began
    if not writes:
        raise SystemExit(f"{folder}: nothing was written")
    trials.writes, expected = writes, content(reference)
    numbers = range(1, writes + 1)[-last if last else 0 :: every]
    kill_settings: list[dict[str, Any]] = [{"dies_at": number} for number in numbers]
    kill_settings += [{"dies_after_s": float(seconds)} for seconds in rng.uniform(1e-3, run_s, moments)]
    for setting in kill_settings:
        out = _fresh(command, folder / "killed")
        if in_child(lambda out=out: command.run(out), out, **setting) is not None:
            continue  # it ended before the kill
        trials.kills += 1
        actual, defect = content(out), command.other_defects(out)
        for name in command.atomic_outputs:
            if content_below(actual, name) not in (
                content_below(before, name),
                content_below(expected, name),
            ):
                defect = f"{name} is neither as it was nor as it will be"
        if inputs != [content(path) for path in command.inputs]:
            defect = "an input has changed"
        in_child(lambda out=out: command.run(out), out)
        if (actual := content(out)) != expected:
            differing = sorted(
                name for name in {*actual, *expected} if actual.get(name) != expected.get(name)
            )
            defect = defect or f"then not as undisturbed: {', '.join(differing[:4])}"
        if defect:
            trials.defects.append(f"{setting}: {defect}")
    return trials


def _fresh(command: Command, folder: Path) -> Path:
    while folder.exists():  # a child of the killed process may still write
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command.prepare(folder)
    return folder


def commands(source: Path, folder: Path) -> dict[str, Command]:
    """All commands that write, on data of `benchmarks/kills.py` in `made`, with their inputs in `folder`."""
    from rf_exp.ablation import PUBLISHED
    from rf_exp.data.__main__ import FORMATS, export, merge_stores
    from rf_exp.data.importing import import_demonstrations
    from rf_exp.rescue import rescue

    publish, release = (
        runpy.run_path(str(ROOT / "scripts" / f"{name}.py"))[name] for name in ("publish", "release")
    )
    (store,), (policies,) = source.glob("data/*/*/*.zarr"), source.glob("policies/*/*/*/*-3-0")
    shutil.rmtree(folder, ignore_errors=True)
    parts = [
        _part(store, folder / f"{name}.zarr", episode_indices)
        for name, episode_indices in (("first", (0, 1)), ("last", (2,)))
    ]
    damaged, older = folder / "damaged.zarr", folder / "older"
    shutil.copytree(store, damaged)
    (damaged / "data/rgb_agent1/c/0/0/0/0").write_bytes(b"no picture")
    original = content(damaged)
    shutil.copytree(source / "results", older / "results")
    for path in older.rglob("*.configuration.json"):
        path.write_text('{"evaluated": "otherwise"}')
    for path in older.rglob("*.jsonl"):
        path.write_bytes(path.read_bytes().replace(b'"success": true', b'"success": false'))
    publish(older, folder / "published", SCENES)
    publish(source, folder / "new", SCENES)
    archive = release(policies, folder).name
    (folder / archive).write_bytes(b"the release before")
    exports = {
        f"export-{form}": Command(
            lambda out, form=form: export(store, out / "export", form),
            inputs=(store,),
            atomic_outputs=("export",),
        )
        for form in FORMATS
    }
    export(store, folder / "raw", "recordepisode")
    return {
        "merge": Command(
            lambda out: merge_stores(parts, out / "merged.zarr"),
            inputs=tuple(parts),
            atomic_outputs=("merged.zarr", "merged.md"),
            other_defects=lambda out: (
                "no card" if [path.name for path in out.glob("m*")] == ["merged.zarr"] else ""
            ),
        ),
        **exports,
        "import": Command(
            lambda out: import_demonstrations([folder / "raw"], out / "s.zarr"),
            inputs=(folder / "raw",),
            atomic_outputs=("s.md",),
        ),
        "rescue": Command(
            lambda out: rescue(out / "q.zarr"),
            prepare=lambda out: shutil.copytree(damaged, out / "q.zarr"),
            other_defects=lambda out: (
                "" if original in map(content, out.glob("q*.zarr")) else "the damaged store is nowhere"
            ),
        ),
        "release": Command(
            lambda out: release(policies, out),
            prepare=lambda out: shutil.copyfile(folder / archive, out / archive),
            inputs=(policies,),
            atomic_outputs=(archive,),
        ),
        "publish": Command(
            lambda out: publish(source, out / "published", SCENES),
            prepare=lambda out: shutil.copytree(folder / "published", out / "published"),
            inputs=(source / "results", source / "policies"),
            atomic_outputs=tuple(
                str(Path("published", path.relative_to(folder / "new")))
                for path in (folder / "new").rglob(f"*{PUBLISHED}")
            ),
        ),
    }


def _part(store: Path, to: Path, episodes: Sequence[int]) -> Path:
    """Copies some episodes of a store to a new store."""
    from rf_exp.store import Store, empty_like

    source = Store.open(store)
    empty_like(to, source.attrs)
    with Store.open(to, writable=True) as part:
        for index in episodes:
            part.append(source.episode(index))
    return to


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--commands", help="with commas between; all")
    parser.add_argument("--every", type=int, default=1, help="of so many writes one is not made")
    parser.add_argument("--kills", type=int, default=30, help="at random moments, of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("outputs/kills"))
    args = parser.parse_args()
    folder = args.folder.resolve()
    runpy.run_path(str(Path(__file__).with_name("kills.py")))["undisturbed"](folder / "whole")
    all_commands = commands(folder / "whole", folder / "inputs")
    results = {}
    for name in args.commands.split(",") if args.commands else all_commands:
        trials = killed(all_commands[name], folder / name, args.every, moments=args.kills, seed=args.seed)
        results[name] = trials.row
        print(name, trials.row, *trials.defects, sep="\n  ", flush=True)
    print(json.dumps({"benchmark": "writes", **results}))


if __name__ == "__main__":
    main()
