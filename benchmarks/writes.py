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
HANG_S = 300  # a command that takes longer is ended
SCENES = 3  # of the experiment that kills.py makes
CHANGED = {  # audit event -> indices of its arguments with the changed path and the descriptor of its folder
    "os.mkdir": (0, 2),
    "os.rename": (1, 3),
    "os.remove": (0, 1),
    "os.rmdir": (0, 1),
    "os.link": (1, 3),
    "os.symlink": (1, 2),
    "os.truncate": (0, None),
}
FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC

Content = dict[str, str]  # path -> digest of its bytes


@dataclass(frozen=True)
class Command:
    """A command as a function, with its inputs and outputs."""

    run: Callable[[Path], object]  # takes the folder below which it writes
    prepare: Callable[[Path], object] = lambda folder: None  # fills the folder beforehand
    inputs: tuple[Path, ...] = ()  # only read
    whole: tuple[
        str, ...
    ] = ()  # files and folders that must be in their old or their new state, never in between
    # Further defects of the folder after a kill, in words; empty for none.
    torn: Callable[[Path], str] = lambda folder: ""


@dataclass
class Trials:
    """Results of the kills of one command."""

    kills: int = 0
    writes: int = 0
    wrong: list[str] = field(default_factory=list)

    @property
    def row(self) -> dict[str, Any]:
        return {"writes": self.writes, "kills": self.kills, "right": self.kills - len(self.wrong)}


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
        made = 0

        def count(event: str, args: tuple[Any, ...]) -> None:
            nonlocal made
            if writes_below(str(below), event, args):
                made += 1
                if made == dies_at:
                    os.kill(os.getpid(), signal.SIGKILL)

        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.fsync = lambda _: None  # data in the page cache survives a kill: no need to wait for a disk
            signal.alarm(HANG_S)
            sys.addaudithook(count)
            job()
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
        finally:
            os.write(write, str(made).encode())
            os._exit(0)
    os.close(write)
    if dies_after_s:
        time.sleep(dies_after_s)
        os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    with open(read, "rb") as told:
        said = told.read()
    return int(said) if said else None


def writes_below(below: str, event: str, args: tuple[Any, ...]) -> bool:
    """Whether an audit event of Python is a change below a folder."""
    if event == "open":
        path, _, flags = args
        return isinstance(flags, int) and bool(flags & FOR_WRITING) and str(path).startswith(below)
    if event not in CHANGED:
        return False
    of, within = CHANGED[event]
    path = os.fsdecode(args[of]) if not isinstance(args[of], int) else f"/proc/self/fd/{args[of]}"
    if within is not None and args[within] != -1:
        path = os.path.join(os.readlink(f"/proc/self/fd/{args[within]}"), path)
    return path.startswith(below)


def content(folder: Path) -> Content:
    """The content of a folder without lock files, which contain their holders."""
    found: Content = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() and not any(path.iterdir()):
            found[name] = "empty folder"
        elif path.is_file() and path.suffix != ".lock":
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def of(found: Content, name: str) -> Content:
    """The part of a content that is a file or lies in a folder."""
    return {path: digest for path, digest in found.items() if path == name or path.startswith(f"{name}/")}


def killed(
    command: Command, folder: Path, every: int = 1, last: int | None = None, moments: int = 0, seed: int = 0
) -> Trials:
    """Kills a command before every `every`-th of its `last` (default: all) writes, and at random moments."""
    rng, trials = np.random.default_rng(seed), Trials()
    inputs = [content(path) for path in command.inputs]
    before, whole = content(_fresh(command, folder / "killed")), _fresh(command, folder / "whole")
    began = time.monotonic()
    writes = in_child(lambda: command.run(whole), whole)
    took_s = time.monotonic() - began
    if not writes:
        raise SystemExit(f"{folder}: nothing was written")
    trials.writes, wanted = writes, content(whole)
    numbers = range(1, writes + 1)[-last if last else 0 :: every]
    ways: list[dict[str, Any]] = [{"dies_at": number} for number in numbers]
    ways += [{"dies_after_s": float(seconds)} for seconds in rng.uniform(1e-3, took_s, moments)]
    for way in ways:
        out = _fresh(command, folder / "killed")
        if in_child(lambda out=out: command.run(out), out, **way) is not None:
            continue  # it ended before the kill
        trials.kills += 1
        found, wrong = content(out), command.torn(out)
        for name in command.whole:
            if of(found, name) not in (of(before, name), of(wanted, name)):
                wrong = f"{name} is neither as it was nor as it will be"
        if inputs != [content(path) for path in command.inputs]:
            wrong = "an input has changed"
        in_child(lambda out=out: command.run(out), out)
        if (found := content(out)) != wanted:
            differing = sorted(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
            wrong = wrong or f"then not as undisturbed: {', '.join(differing[:4])}"
        if wrong:
            trials.wrong.append(f"{way}: {wrong}")
    return trials


def _fresh(command: Command, folder: Path) -> Path:
    while folder.exists():  # a child of the killed process may still write
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command.prepare(folder)
    return folder


def commands(made: Path, folder: Path) -> dict[str, Command]:
    """All commands that write, on data of `benchmarks/kills.py` in `made`, with their inputs in `folder`."""
    from rf_exp.ablation import PUBLISHED
    from rf_exp.data.__main__ import FORMATS, export, merge_stores
    from rf_exp.data.importing import import_demonstrations
    from rf_exp.rescue import rescue

    publish, release = (
        runpy.run_path(str(ROOT / "scripts" / f"{name}.py"))[name] for name in ("publish", "release")
    )
    (store,), (policies,) = made.glob("data/*/*/*.zarr"), made.glob("policies/*/*/*/*-3-0")
    shutil.rmtree(folder, ignore_errors=True)
    parts = [_part(store, folder / f"{name}.zarr", of) for name, of in (("first", (0, 1)), ("last", (2,)))]
    damaged, older = folder / "damaged.zarr", folder / "older"
    shutil.copytree(store, damaged)
    (damaged / "data/rgb_agent1/c/0/0/0/0").write_bytes(b"no picture")
    original = content(damaged)
    shutil.copytree(made / "results", older / "results")
    for path in older.rglob("*.configuration.json"):
        path.write_text('{"evaluated": "otherwise"}')
    for path in older.rglob("*.jsonl"):
        path.write_bytes(path.read_bytes().replace(b'"success": true', b'"success": false'))
    publish(older, folder / "published", SCENES)
    publish(made, folder / "new", SCENES)
    zipped = release(policies, folder).name
    (folder / zipped).write_bytes(b"the release before")
    exports = {
        f"export-{form}": Command(
            lambda out, form=form: export(store, out / "export", form), inputs=(store,), whole=("export",)
        )
        for form in FORMATS
    }
    export(store, folder / "raw", "recordepisode")
    return {
        "merge": Command(
            lambda out: merge_stores(parts, out / "merged.zarr"),
            inputs=tuple(parts),
            whole=("merged.zarr", "merged.md"),
            torn=lambda out: "no card" if [each.name for each in out.glob("m*")] == ["merged.zarr"] else "",
        ),
        **exports,
        "import": Command(
            lambda out: import_demonstrations([folder / "raw"], out / "s.zarr"),
            inputs=(folder / "raw",),
            whole=("s.md",),
        ),
        "rescue": Command(
            lambda out: rescue(out / "q.zarr"),
            prepare=lambda out: shutil.copytree(damaged, out / "q.zarr"),
            torn=lambda out: (
                "" if original in map(content, out.glob("q*.zarr")) else "the damaged store is nowhere"
            ),
        ),
        "release": Command(
            lambda out: release(policies, out),
            prepare=lambda out: shutil.copyfile(folder / zipped, out / zipped),
            inputs=(policies,),
            whole=(zipped,),
        ),
        "publish": Command(
            lambda out: publish(made, out / "published", SCENES),
            prepare=lambda out: shutil.copytree(folder / "published", out / "published"),
            inputs=(made / "results", made / "policies"),
            whole=tuple(
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
    given = parser.parse_args()
    folder = given.folder.resolve()
    runpy.run_path(str(Path(__file__).with_name("kills.py")))["undisturbed"](folder / "whole")
    known = commands(folder / "whole", folder / "inputs")
    found = {}
    for name in given.commands.split(",") if given.commands else known:
        trials = killed(known[name], folder / name, given.every, moments=given.kills, seed=given.seed)
        found[name] = trials.row
        print(name, trials.row, *trials.wrong, sep="\n  ", flush=True)
    print(json.dumps({"benchmark": "writes", **found}))


if __name__ == "__main__":
    main()
