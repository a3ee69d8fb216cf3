"""Import command: copies a source into a store, with a card that lists what is missing.

An interrupted import resumes: episodes already in the store are not read again.
"""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from rf_exp.artifacts import write_text_if_changed
from rf_exp.data.importing import hdf5, lightning, replay_buffer, trajectories
from rf_exp.data.importing.source import Source, checked_name, import_error
from rf_exp.data.release import task_of
from rf_exp.errors import ArgumentError, StageError
from rf_exp.progress import Progress, console
from rf_exp.store import Store, card, flaws, other_kind
from rf_exp.texts import LONGEST_LINE, printable

PICKLES = (".pkl", ".pickle", ".ckpt", ".pt", ".pth")
HDF5 = (".h5", ".hdf5")
SUPPORTED = (
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
    with closing(open_source(paths, task)) as source:
        contents = source.contents
        for note in contents.notes:
            console.print(printable(note, LONGEST_LINE))
        console.print(f"missing: {', '.join(contents.missing)}")
        cameras = ", ".join(contents.cameras) or "none"
        size = f"{len(contents.seeds)} episodes of {contents.task}, {sum(contents.steps)} steps"
        summary = f"{size}, {contents.agents} arms, cameras {cameras}"
        if dry_run:
            stored = len(Store.open(to, contents.identity)) if to.exists() else 0
            console.print(f"{to} would hold {summary}; {stored} episodes are there, and nothing was written")
            return
        flaw_lines = _copy(source, to)
        console.print(f"{to} holds {summary}")
        for line in flaw_lines:
            console.print(printable(f"{to}: {line}", LONGEST_LINE))


def _copy(source: Source, to: Path) -> list[str]:
    """Copies the episodes that the store lacks; returns what is wrong with them."""
    from rf_exp.stages import artifact_lock  # imports what stages need, which --help does not

    contents, flaw_lines = source.contents, list[str]()
    with artifact_lock(to), _open_store(source, to) as store:
        stored_seeds = {*store.seeds.tolist()}
        with Progress(f"import {to}", len(contents.seeds), "episodes", len(stored_seeds)) as progress:
            for index, seed in enumerate(contents.seeds):
                if seed in stored_seeds:
                    continue
                episode = source.episode(index)
                flaw_lines += [f"episode of seed {seed}: {flaw}" for flaw in flaws(episode)]
                store.append(episode)
                progress.advance()
        write_text_if_changed(to.with_suffix(".md"), card(store))
    return flaw_lines


def _open_store(source: Source, to: Path) -> Store:
    contents = source.contents
    if to.exists():
        return Store.open(to, contents.identity, writable=True)
    size = contents.agents, contents.cameras, *contents.size_px, contents.objects, contents.disturbed
    return Store.create(to, contents.identity, *size, contents.description)


def open_source(paths: Sequence[Path], task: str | None) -> Source:
    """Opens and surveys a source of a known format. Raises ArgumentError and StageError."""
    for path in paths:
        _refuse_unsupported(path)
    if len(paths) == 1 and paths[0].is_dir() and not replay_buffer.is_buffer(paths[0]):
        paths = replay_buffer.find_arm_buffers(paths[0]) or sorted(
            file for file in paths[0].iterdir() if file.suffix in HDF5
        )
    if all(map(replay_buffer.is_buffer, paths)):
        return replay_buffer.read(paths, checked_name(paths[0], task or task_of(paths[0].name)))
    if len(paths) > 1:
        raise ArgumentError(
            f"{len(paths)} sources are no arms of one data set; import {paths[0]} and others one by one"
        )
    path = paths[0]
    file = hdf5.open_file(path)
    try:
        names = hdf5.member_names(path, file)
        if lightning.is_lightning_file(names):
            task_name = task_of(path.stem) or task_of(path.parent.name)
            return lightning.read(path, file, checked_name(path, task or task_name))
        if any(name.startswith("traj_") for name in names):
            return trajectories.read(path, file, task)
        raise ArgumentError(
            f"{path} is an HDF5 file with {', '.join(names[:8]) or 'nothing'} in it; {SUPPORTED}"
        )
    except BaseException:
        file.close()
        raise


def _find_pickle(folder: Path) -> str:
    """Path of a pickle in a folder laid out as the release's; empty where there are none."""
    files = (file for depth in ("*", "*/*", "*/*/*") for file in folder.glob(depth))
    return next((file.relative_to(folder).as_posix() for file in files if file.suffix in PICKLES), "")


def _refuse_unsupported(path: Path) -> None:
    """Raises ArgumentError for a path that no importer reads, naming alternatives."""
    try:
        if not path.exists():
            raise ArgumentError(f"there is nothing at {path}; {SUPPORTED}")
        kind = other_kind(path)
        names = sorted(child.name for child in path.iterdir()) if path.is_dir() else []
        pickled = _find_pickle(path) if path.is_dir() and not replay_buffer.is_buffer(path) else ""
    except OSError as error:
        raise StageError(f"{path} cannot be read: {error.strerror or error}") from error
    if path.suffix in PICKLES or kind == "a pickle" or pickled:
        noun = f"a folder of pickles ({pickled})" if pickled else "a pickle"
        raise ArgumentError(
            f"{path} is {noun}; pickles can run any code, and none is ever loaded: import the .h5 of which "
            "the release makes them, demos/<Task>-rf/motionplanning/<stamp>.h5, or the Zarr made of them"
        )
    if not kind:
        raise ArgumentError(
            f"{path} is a store of rf_exp already, whole or damaged: summary, validate and merge read it"
        )
    if path.is_dir():
        is_buffer = replay_buffer.is_buffer(path) or replay_buffer.find_arm_buffers(path)
        files = [name for name in names if name.endswith(HDF5)]
        if not is_buffer and len(files) > 1:
            raise ArgumentError(
                f"{path} holds {len(files)} HDF5 files, {', '.join(files[:8])}; name one of them"
            )
        if not is_buffer and not files:
            raise ArgumentError(f"{path} is {kind}; {SUPPORTED}")
    elif kind != "an HDF5 file" and path.suffix in HDF5:
        raise import_error(path, "it does not begin as an HDF5 file does")
    elif kind != "an HDF5 file":
        raise ArgumentError(f"{path} is {kind}; {SUPPORTED}")
