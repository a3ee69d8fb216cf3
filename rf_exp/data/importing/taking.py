"""Import command: copies a source into a store, with a card that lists what is missing.

An interrupted import resumes: episodes already in the store are not read again.
"""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from rf_exp.artifacts import keep_text
from rf_exp.data.importing import hdf5, lightning, replay_buffer, trajectories
from rf_exp.data.importing.source import Source, checked_name, refused
from rf_exp.data.release import task_of
from rf_exp.errors import ArgumentError, StageError
from rf_exp.progress import Progress, console
from rf_exp.store import Store, card, flaws, other_kind
from rf_exp.texts import LONGEST_LINE, printable

PICKLES = (".pkl", ".pickle", ".ckpt", ".pt", ".pth")
HDF5 = (".h5", ".hdf5")
POSSIBLE = (
    "possible are the .h5 of ManiSkill's RecordEpisode or of Policy-Lightning, and a Zarr 2 replay buffer of "
    "Diffusion Policy, or those of all arms of the release"
)


def import_demonstrations(
    paths: Sequence[Path], to: Path, task: str | None = None, dry_run: bool = False
) -> None:
    """Imports a file, a folder, or the folders of all arms into the store `to`; resumes if interrupted.

    `task` is the task name, where the source has none or to override it. Raises ArgumentError for an unknown
    format, StageError for a source that violates its format, where `to` is something else, and where it
    cannot be written.
    """
    with closing(opened(paths, task)) as source:
        said = source.contents
        for note in said.notes:
            console.print(printable(note, LONGEST_LINE))
        console.print(f"missing: {', '.join(said.missing)}")
        cameras = ", ".join(said.cameras) or "none"
        size = f"{len(said.seeds)} episodes of {said.task}, {sum(said.steps)} steps"
        what = f"{size}, {said.agents} arms, cameras {cameras}"
        if dry_run:
            there = len(Store.open(to, said.identity)) if to.exists() else 0
            console.print(f"{to} would hold {what}; {there} episodes are there, and nothing was written")
            return
        wrong = _copy(source, to)
        console.print(f"{to} holds {what}")
        for each in wrong:
            console.print(printable(f"{to}: {each}", LONGEST_LINE))


def _copy(source: Source, to: Path) -> list[str]:
    """Copies the episodes that the store lacks; returns what is wrong with them."""
    from rf_exp.stages import owned  # imports what stages need, which --help does not

    said, wrong = source.contents, list[str]()
    with owned(to), _store(source, to) as store:
        there = {*store.seeds.tolist()}
        with Progress(f"import {to}", len(said.seeds), "episodes", len(there)) as progress:
            for index, seed in enumerate(said.seeds):
                if seed in there:
                    continue
                episode = source.episode(index)
                wrong += [f"episode of seed {seed}: {each}" for each in flaws(episode)]
                store.append(episode)
                progress.advance()
        keep_text(to.with_suffix(".md"), card(store))
    return wrong


def _store(source: Source, to: Path) -> Store:
    said = source.contents
    if to.exists():
        return Store.open(to, said.identity, writable=True)
    size = said.agents, said.cameras, *said.size_px, said.objects, said.disturbed
    return Store.create(to, said.identity, *size, said.description)


def opened(paths: Sequence[Path], task: str | None) -> Source:
    """Opens and surveys a source of a known format. Raises ArgumentError and StageError."""
    for path in paths:
        _refuse_others(path)
    if len(paths) == 1 and paths[0].is_dir() and not replay_buffer.is_buffer(paths[0]):
        paths = replay_buffer.arms(paths[0]) or sorted(
            each for each in paths[0].iterdir() if each.suffix in HDF5
        )
    if all(map(replay_buffer.is_buffer, paths)):
        return replay_buffer.read(paths, checked_name(paths[0], task or task_of(paths[0].name)))
    if len(paths) > 1:
        raise ArgumentError(
            f"{len(paths)} sources are no arms of one data set; import {paths[0]} and others one by one"
        )
    path = paths[0]
    file = hdf5.opened(path)
    try:
        names = hdf5.names(path, file)
        if lightning.holds(names):
            named = task_of(path.stem) or task_of(path.parent.name)
            return lightning.read(path, file, checked_name(path, task or named))
        if any(name.startswith("traj_") for name in names):
            return trajectories.read(path, file, task)
        raise ArgumentError(
            f"{path} is an HDF5 file with {', '.join(names[:8]) or 'nothing'} in it; {POSSIBLE}"
        )
    except BaseException:
        file.close()
        raise


def _pickle(folder: Path) -> str:
    """Path of a pickle in a folder laid out as the release's; empty where there are none."""
    files = (each for depth in ("*", "*/*", "*/*/*") for each in folder.glob(depth))
    return next((each.relative_to(folder).as_posix() for each in files if each.suffix in PICKLES), "")


def _refuse_others(path: Path) -> None:
    """Raises ArgumentError for a path that no importer reads, naming alternatives."""
    try:
        if not path.exists():
            raise ArgumentError(f"there is nothing at {path}; {POSSIBLE}")
        kind = other_kind(path)
        within = sorted(each.name for each in path.iterdir()) if path.is_dir() else []
        pickled = _pickle(path) if path.is_dir() and not replay_buffer.is_buffer(path) else ""
    except OSError as error:
        raise StageError(f"{path} cannot be read: {error.strerror or error}") from error
    if path.suffix in PICKLES or kind == "a pickle" or pickled:
        what = f"a folder of pickles ({pickled})" if pickled else "a pickle"
        raise ArgumentError(
            f"{path} is {what}; pickles can run any code, and none is ever loaded: import the .h5 of which "
            "the release makes them, demos/<Task>-rf/motionplanning/<stamp>.h5, or the Zarr made of them"
        )
    if not kind:
        raise ArgumentError(
            f"{path} is a store of rf_exp already, whole or damaged: summary, validate and merge read it"
        )
    if path.is_dir():
        usable = replay_buffer.is_buffer(path) or replay_buffer.arms(path)
        files = [name for name in within if name.endswith(HDF5)]
        if not usable and len(files) > 1:
            raise ArgumentError(
                f"{path} holds {len(files)} HDF5 files, {', '.join(files[:8])}; name one of them"
            )
        if not usable and not files:
            raise ArgumentError(f"{path} is {kind}; {POSSIBLE}")
    elif kind != "an HDF5 file" and path.suffix in HDF5:
        raise refused(path, "it does not begin as an HDF5 file does")
    elif kind != "an HDF5 file":
        raise ArgumentError(f"{path} is {kind}; {POSSIBLE}")
