"""Data set tools: inspect, validate and merge stores, import and export other formats.

python -m rf_exp.data summary STORE...                    contents of the stores
python -m rf_exp.data validate STORE...                   reads every byte and checks the values
python -m rf_exp.data doctor STORE... --reference STORE    finds data that will harm training
python -m rf_exp.data merge STORE... --to STORE           joins stores of one configuration into one
python -m rf_exp.data redraw STORE NEW --variation NAME --copies 4    each episode also in other appearances
python -m rf_exp.data export STORE FOLDER --format lerobot    writes other formats: lerobot, robomimic, ...
python -m rf_exp.data import SOURCE... STORE              reads data of others: Zarr 2, HDF5; never pickles

`COMMAND --help` lists the arguments. docs/data.md.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from rf_exp.artifacts import sweep, whole, write_text
from rf_exp.command import guarded
from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.progress import Progress, console
from rf_exp.store import Damage, Store, card, facts, merge, merge_order, problems
from rf_exp.texts import LONGEST_LINE, printable

# Each is the name of a module.
FORMATS = ("lerobot", "lerobot_v21", "robomimic", "robofactory", "policy_lightning", "recordepisode")
OF_ONE_AGENT = ("lerobot", "lerobot_v21")  # the others keep arms apart, or need all of them


def summarise(paths: Sequence[Path], as_json: bool = False) -> None:
    """Prints the contents of stores. Raises StageError for one that cannot be opened."""
    found = {str(path): {**facts(Store.open(path)), "MiB": mib(path)} for path in paths}
    if as_json:
        console.print(json.dumps(found, indent=2))
        return
    for path, said in found.items():
        console.print(printable(path, LONGEST_LINE))
        for name, value in said.items():
            console.print(f"  {name}: {value}")


def validate(paths: Sequence[Path]) -> None:
    """Reads everything in stores and prints all problems. Raises StageError at the end if there are any."""
    wrong = unread = 0
    for path in paths:
        try:
            store = Store.open(path)
        except StageError as error:
            wrong += isinstance(error, Damage)
            unread += not isinstance(error, Damage)  # other kind or version: not a defect
            console.print(str(error))
            continue
        found: list[str] = []
        with Progress(f"validate {path}", len(store), "episodes") as progress:
            for index in range(len(store)):
                found += problems(store, index)
                progress.advance(note=f"{len(found)} problems")
        for what in found:
            console.print(printable(f"{path}: {what}", LONGEST_LINE))
        if not found:
            console.print(f"{path}: all {len(store)} episodes are as they should be")
        wrong += bool(found)
    told = {"are not as they should be; what is wrong": wrong, "cannot be validated; why": unread}
    if wrong or unread:
        said = (f"{number} of {len(paths)} stores {what} is above" for what, number in told.items() if number)
        raise StageError("; ".join(said))


def examine(paths: Sequence[Path], reference: Path | None = None) -> None:
    """Prints what in stores will harm training. Raises StageError at the end if anything does."""
    from rf_exp.data.doctor import harms

    beside, harmful = reference and Store.open(reference), 0
    for path in paths:
        found = [str(harm) for harm in harms(Store.open(path), beside)]
        for what in found or ["nothing is found that would harm who learns from it"]:
            console.print(printable(f"{path}: {what}", LONGEST_LINE))
        harmful += bool(found)
    if harmful:
        raise StageError(
            f"in {harmful} of {len(paths)} stores something will harm who learns from it; see above"
        )


def merge_stores(paths: Sequence[Path], to: Path, dry_run: bool = False) -> None:
    """Merges stores into one.

    Raises StageError where they are not parts of one, and where `to` exists or cannot be written.
    """
    refuse_existing(to, dry_run)
    stores = [Store.open(path) for path in paths]
    order = merge_order(stores)
    first = order[0][0] if order else 0
    what = f"{sum(map(len, stores))} episodes of {len(stores)} stores, from seed {first} on"
    if dry_run:
        console.print(f"{to} would hold {what}; nothing was written")
        return
    with writing(to), Progress(f"merge {to}", len(order), "episodes") as progress:
        merge(stores, to, progress.advance)
    console.print(f"{to} holds {what}")


def redraw_store(path: Path, to: Path, variation: str, copies: int, folder: Path | None) -> None:
    """Writes a store with `copies` of each episode in other appearances; resumes an interrupted run.

    `folder` holds the YAML files of the tasks, by default those of the suite. Raises ArgumentError for a
    variation that would move objects, StageError where the store cannot be read or `to` is another store.
    """
    from rf_exp.stages import redraw  # imports the simulator, which the other commands do not need
    from rf_exp.tasks import CONFIGURED, read_variation, stored_task

    source = Store.open(path)
    if not source.cameras:
        raise StageError(f"{path} holds no pictures; there is nothing to draw anew")
    task = stored_task(source.identity, folder or CONFIGURED)
    redraw(source, to, task, read_variation(variation), copies)
    console.print(f"{to} holds {len(source)} episodes, {copies} times each: {mib(to)} MiB")


def export(
    path: Path,
    folder: Path,
    form: str,
    pictures: str | None = None,
    dry_run: bool = False,
    agent: int | None = None,
) -> None:
    """Exports a store to another format; `folder` is written atomically.

    With `agent` only the observations and actions of that agent, for tools that support one arm. Raises
    ArgumentError for an unknown format or picture encoding, and for an agent that does not exist or that the
    format cannot hold alone; StageError where `folder` exists or the store cannot be read.
    """
    if form not in FORMATS:
        raise choices("format", form, FORMATS)
    how = import_module(f"rf_exp.data.{form}")
    kept = pictures or how.PICTURES[0]
    if kept not in how.PICTURES:
        raise choices(f"way to keep pictures in {form}", kept, how.PICTURES)
    if agent is not None and form not in OF_ONE_AGENT:
        raise ArgumentError(f"--agent {agent}: {form} holds all arms; one alone: {', '.join(OF_ONE_AGENT)}")
    refuse_existing(folder, dry_run)
    store = Store.open(path)
    if not len(store):
        raise StageError(f"{path} holds no episodes; there is nothing to export")
    if agent is not None and not 1 <= agent <= store.agents:
        raise ArgumentError(f"--agent {agent}: {path} has agents 1 to {store.agents}")
    alone = {} if agent is None else {"agent": agent}
    what = f"{len(store)} episodes, {store.steps} steps"
    what += f", cameras {', '.join(store.cameras) or 'none'}" if agent is None else f" of agent {agent}"
    held = how.held(kept, **alone)
    if dry_run:
        console.print(f"{folder} would hold {what}; nothing was written\n{held}")
        return
    with (
        writing(folder),
        whole(folder) as draft,
        Progress(f"export {form}", len(store), "episodes") as progress,
    ):
        draft.mkdir()
        how.write(store, draft, kept, progress.advance, **alone)
        write_text(draft / "README.md", card(store, held, how.TAGS))
    console.print(f"{folder} holds {what}: {mib(folder)} MiB, the store {mib(path)} MiB")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns an OSError while a new folder is written into a StageError."""
    try:
        yield
    except OSError as error:
        raise StageError(f"cannot write {path}: {error.strerror or error}; nothing is left there") from error


def refuse_existing(path: Path, dry_run: bool) -> None:
    """Raises StageError for an existing path. Removes stale drafts beside it, except in a dry run."""
    if not dry_run:
        sweep(path.parent)  # also those of a command that was killed after its last rename
    if path.exists():
        raise StageError(
            f"{path} exists already; nothing is written over it: name a folder that is not there"
        )


def mib(folder: Path) -> float:
    return round(sum(each.stat().st_size for each in folder.rglob("*") if each.is_file()) / 2**20, 2)


def import_stores(**given: Any) -> None:
    from rf_exp.data.importing import import_demonstrations  # imports the readers, which --help does not need

    import_demonstrations(**given)


def parser() -> argparse.ArgumentParser:
    """The argument parser; each command sets `run`, the function to call with its other arguments."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m rf_exp.data", description=__doc__, formatter_class=plain)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, run: Callable[..., None], help: str) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=help)
        made.set_defaults(run=run)
        return made

    summary = command("summary", summarise, "what is in stores")
    summary.add_argument("--json", dest="as_json", action="store_true", help="for programs")
    checked = command("validate", validate, "read every byte of stores, and judge what it says")
    examined = command("doctor", examine, "what in stores will harm who learns from them")
    whose = "whose pictures are as they should be: as bright as those"
    examined.add_argument("--reference", type=Path, metavar="STORE", help=whose)
    merged = command("merge", merge_stores, "one store of those of one configuration with other seeds")
    merged.add_argument("--to", type=Path, required=True, metavar="STORE", help="the new store")
    exported = command("export", export, "a store in a format that others read")
    store = "folder of a store, such as outputs/data/.../fast.zarr"
    exported.add_argument("path", type=Path, metavar="store", help=store)
    exported.add_argument("folder", type=Path, help="new folder for the export")
    exported.add_argument("--format", dest="form", metavar="FORMAT", required=True, help=" or ".join(FORMATS))
    exported.add_argument(
        "--pictures",
        help="how pictures are kept, every pixel: video (lossless) or png by lerobot, gzip or plain by "
        "robomimic and the HDF5 of others; the first of them unless given",
    )
    alone = "of agent K alone, with its own camera and the global one, for tools that know one arm: "
    exported.add_argument("--agent", type=int, metavar="K", help=alone + " and ".join(OF_ONE_AGENT))
    taken = command("import", import_stores, "a store of demonstrations of others")
    sources = (
        "the .h5 of ManiSkill's RecordEpisode or of Policy-Lightning; a Zarr 2 replay buffer, or those "
        "of all arms one after the other; or the folder in which they are"
    )
    taken.add_argument("paths", type=Path, nargs="+", metavar="SOURCE", help=sources)
    begun = "the new store; one that was begun is gone on with"
    taken.add_argument("to", type=Path, metavar="STORE", help=begun)
    taken.add_argument("--task", metavar="NAME", help="of the demonstrations, where nothing there says it")
    redrawn = command("redraw", redraw_store, "the episodes of a store in other appearances, too")
    redrawn.add_argument("path", type=Path, metavar="store", help="folder of a store")
    redrawn.add_argument("to", type=Path, metavar="new", help=f"folder of {begun}")
    redrawn.add_argument("--variation", required=True, metavar="NAME", help="one of conf/variation")
    redrawn.add_argument("--copies", type=int, required=True, help="of each episode, the first as it is")
    own = "of tasks' YAML files, if yours"
    redrawn.add_argument("--tasks", dest="folder", type=Path, metavar="FOLDER", help=own)
    for several in (summary, checked, examined, merged):
        several.add_argument("paths", type=Path, nargs="+", metavar="stores", help="folders of stores")
    for writes in (merged, exported, taken):
        told = "say what would be written, and write nothing"
        writes.add_argument("--dry-run", action="store_true", help=told)
    return parser


def main() -> None:
    given = vars(parser().parse_args())
    del given["command"]
    given.pop("run")(**given)


if __name__ == "__main__":
    sys.exit(guarded(main))
