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

from rf_exp.artifacts import atomic_path, remove_stale_drafts, write_text
from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError, StageError, unknown_choice
from rf_exp.progress import Progress, console
from rf_exp.store import Damage, Store, card, facts, merge, merge_order, problems
from rf_exp.texts import LONGEST_LINE, printable

# Each is the name of a module.
FORMATS = ("lerobot", "lerobot_v21", "robomimic", "robofactory", "policy_lightning", "recordepisode")
OF_ONE_AGENT = ("lerobot", "lerobot_v21")  # the others keep arms apart, or need all of them


def summarise(paths: Sequence[Path], as_json: bool = False) -> None:
    """Prints the contents of stores. Raises StageError for one that cannot be opened."""
    facts_by_path = {str(path): {**facts(Store.open(path)), "MiB": mib(path)} for path in paths}
    if as_json:
        console.print(json.dumps(facts_by_path, indent=2))
        return
    for path, store_facts in facts_by_path.items():
        console.print(printable(path, LONGEST_LINE))
        for name, value in store_facts.items():
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
        flaws: list[str] = []
        with Progress(f"validate {path}", len(store), "episodes") as progress:
            for index in range(len(store)):
                flaws += problems(store, index)
                progress.advance(note=f"{len(flaws)} problems")
        for flaw in flaws:
            console.print(printable(f"{path}: {flaw}", LONGEST_LINE))
        if not flaws:
            console.print(f"{path}: all {len(store)} episodes are as they should be")
        wrong += bool(flaws)
    counts = {"are not as they should be; what is wrong": wrong, "cannot be validated; why": unread}
    if wrong or unread:
        parts = (
            f"{number} of {len(paths)} stores {outcome} is above"
            for outcome, number in counts.items()
            if number
        )
        raise StageError("; ".join(parts))


def examine(paths: Sequence[Path], reference: Path | None = None) -> None:
    """Prints what in stores will harm training. Raises StageError at the end if anything does."""
    from rf_exp.data.doctor import find_problems

    reference_store, harmful = reference and Store.open(reference), 0
    for path in paths:
        lines = [str(problem) for problem in find_problems(Store.open(path), reference_store)]
        for line in lines or ["no problems for training were found"]:
            console.print(printable(f"{path}: {line}", LONGEST_LINE))
        harmful += bool(lines)
    if harmful:
        raise StageError(f"{harmful} of {len(paths)} stores have problems that will harm training; see above")


def merge_stores(paths: Sequence[Path], to: Path, dry_run: bool = False) -> None:
    """Merges stores into one.

    Raises StageError where they are not parts of one, and where `to` exists or cannot be written.
    """
    refuse_existing(to, dry_run)
    stores = [Store.open(path) for path in paths]
    order = merge_order(stores)
    first = order[0][0] if order else 0
    contents = f"{sum(map(len, stores))} episodes of {len(stores)} stores, from seed {first} on"
    if dry_run:
        console.print(f"{to} would hold {contents}; nothing was written")
        return
    with writing(to), Progress(f"merge {to}", len(order), "episodes") as progress:
        merge(stores, to, progress.advance)
    console.print(f"{to} holds {contents}")


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
        raise unknown_choice("format", form, FORMATS)
    exporter = import_module(f"rf_exp.data.{form}")
    encoding = pictures or exporter.PICTURES[0]
    if encoding not in exporter.PICTURES:
        raise unknown_choice(f"way to keep pictures in {form}", encoding, exporter.PICTURES)
    if agent is not None and form not in OF_ONE_AGENT:
        raise ArgumentError(f"--agent {agent}: {form} holds all arms; one alone: {', '.join(OF_ONE_AGENT)}")
    refuse_existing(folder, dry_run)
    store = Store.open(path)
    if not len(store):
        raise StageError(f"{path} holds no episodes; there is nothing to export")
    if agent is not None and not 1 <= agent <= store.agents:
        raise ArgumentError(f"--agent {agent}: {path} has agents 1 to {store.agents}")
    options = {} if agent is None else {"agent": agent}
    contents = f"{len(store)} episodes, {store.steps} steps"
    contents += f", cameras {', '.join(store.cameras) or 'none'}" if agent is None else f" of agent {agent}"
    format_note = exporter.describe(encoding, **options)
    if dry_run:
        console.print(f"{folder} would hold {contents}; nothing was written\n{format_note}")
        return
    with (
        writing(folder),
        atomic_path(folder) as draft,
        Progress(f"export {form}", len(store), "episodes") as progress,
    ):
        draft.mkdir()
        exporter.write(store, draft, encoding, progress.advance, **options)
        write_text(draft / "README.md", card(store, format_note, exporter.TAGS))
    console.print(f"{folder} holds {contents}: {mib(folder)} MiB, the store {mib(path)} MiB")


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
        remove_stale_drafts(path.parent)  # also those of a command that was killed after its last rename
    if path.exists():
        raise StageError(
            f"{path} exists already; nothing is written over it: name a folder that is not there"
        )


def mib(folder: Path) -> float:
    return round(sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 2**20, 2)


def import_stores(**options: Any) -> None:
    from rf_exp.data.importing import import_demonstrations  # imports the readers, which --help does not need

    import_demonstrations(**options)


def parser() -> argparse.ArgumentParser:
    """The argument parser; each command sets `run`, the function to call with its other arguments."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m rf_exp.data", description=__doc__, formatter_class=formatter)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, run: Callable[..., None], help: str) -> argparse.ArgumentParser:
        subparser = commands.add_parser(name, help=help)
        subparser.set_defaults(run=run)
        return subparser

    summary = command("summary", summarise, "contents of stores")
    summary.add_argument("--json", dest="as_json", action="store_true", help="for programs")
    validated = command("validate", validate, "read every byte of stores and check the values")
    examined = command("doctor", examine, "data in stores that will harm training")
    reference_help = "store of the same cameras, to compare the brightness of pictures with"
    examined.add_argument("--reference", type=Path, metavar="STORE", help=reference_help)
    merged = command("merge", merge_stores, "merge stores of one configuration with different seeds into one")
    merged.add_argument("--to", type=Path, required=True, metavar="STORE", help="the new store")
    exported = command("export", export, "export a store to another format")
    store = "folder of a store, such as outputs/data/.../fast.zarr"
    exported.add_argument("path", type=Path, metavar="store", help=store)
    exported.add_argument("folder", type=Path, help="new folder for the export")
    exported.add_argument("--format", dest="form", metavar="FORMAT", required=True, help=" or ".join(FORMATS))
    exported.add_argument(
        "--pictures",
        help="encoding of the pictures, all lossless: video or png for lerobot, gzip or plain for robomimic "
        "and the other HDF5 formats; default: the first of them",
    )
    agent_help = "only agent K, with its own camera and the global one, for tools that support one arm: "
    exported.add_argument("--agent", type=int, metavar="K", help=agent_help + " and ".join(OF_ONE_AGENT))
    imported = command("import", import_stores, "import demonstrations of other projects into a store")
    sources_help = (
        "the .h5 of ManiSkill's RecordEpisode or of Policy-Lightning; a Zarr 2 replay buffer, or those "
        "of all arms one after the other; or the folder that holds them"
    )
    imported.add_argument("paths", type=Path, nargs="+", metavar="SOURCE", help=sources_help)
    store_help = "the new store; an unfinished one is resumed"
    imported.add_argument("to", type=Path, metavar="STORE", help=store_help)
    imported.add_argument("--task", metavar="NAME", help="task name, where the source has none")
    redrawn = command("redraw", redraw_store, "render the episodes of a store also in other appearances")
    redrawn.add_argument("path", type=Path, metavar="store", help="folder of a store")
    redrawn.add_argument("to", type=Path, metavar="new", help=f"folder of {store_help}")
    redrawn.add_argument("--variation", required=True, metavar="NAME", help="one of conf/variation")
    redrawn.add_argument(
        "--copies", type=int, required=True, help="copies of each episode; the first keeps its appearance"
    )
    tasks_help = "folder of your own tasks' YAML files"
    redrawn.add_argument("--tasks", dest="folder", type=Path, metavar="FOLDER", help=tasks_help)
    for subparser in (summary, validated, examined, merged):
        subparser.add_argument("paths", type=Path, nargs="+", metavar="stores", help="folders of stores")
    for subparser in (merged, exported, imported):
        dry_run_help = "print what would be written, and write nothing"
        subparser.add_argument("--dry-run", action="store_true", help=dry_run_help)
    return parser


def main() -> None:
    arguments = vars(parser().parse_args())
    del arguments["command"]
    arguments.pop("run")(**arguments)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
