"""Shards: generation in blocks of consecutive seeds, made in parallel by an engine and merged here.

A shard is the stage `generate` of `episodes` seeds with an `out` of its own, `<first>-<last>` in the folder
of all shards of the same configuration, code and assets. So it continues where it was stopped, and is not
made again once it is finished. Rows and episodes are passed on in the order of the seeds, as if they had been
tried here; a shard is removed when all of it has been taken.
"""

import re
import shutil
import socket
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from rf_exp.ablation import GenerationRow
from rf_exp.artifacts import digest, drop_defaults, find_differences, write_json
from rf_exp.errors import StageError
from rf_exp.launch import LOCAL, results
from rf_exp.progress import console
from rf_exp.stages.cell import Cell, artifact_lock, known_rows
from rf_exp.store import Store
from rf_exp.types import Episode

IDENTITY_FILE = "configuration.json"  # with the identity of all shards of a folder
VISIBILITY_S = 90.0  # NFS caches for a minute that a file does not exist
_NAME = re.compile(r"(\d+)-(\d+)")

Attempt = tuple[GenerationRow, Episode | None]


@dataclass(frozen=True)
class Shards:
    """The shards of one cell. `generate` runs the stage for the cell of a shard."""

    cell: Cell
    generate: Callable[[Cell], object]

    @cached_property
    def identity(self) -> dict[str, Any]:
        """The identity of all shards: what decides their bytes beside the seeds."""
        experiment = self.cell.experiment
        return drop_defaults(self.cell.store_identity(experiment.pictures), first_seed=experiment.seed)

    @cached_property
    def folder(self) -> Path:
        """The folder of all shards; absolute, because other machines work there."""
        return self.cell.shards_path(digest(self.identity)).resolve()

    def attempts(self, seeds: Sequence[int], wanted: int | None) -> Iterator[Attempt]:
        """Yields rows and episodes of `seeds` in their order: of all, or until `wanted` have succeeded.

        Begins only shards that would be needed if every seed succeeded. Raises StageError where shards cannot
        be made, or have the wrong content.
        """
        launch, remaining = self.cell.experiment.launch, dict.fromkeys(seeds)
        write_json(self.folder / IDENTITY_FILE, self.identity)
        while remaining and wanted != 0:
            planned = plan_shards([*remaining], existing_shards(self.folder), launch.shard_seeds, wanted)
            missing = [block for block in planned if not self._finished(block)]
            jobs = (partial(make_shard, self.shard_for(block), self.identity) for block in missing)
            finished = results(launch, jobs, self.cell.experiment.workers, self.folder)
            console.print(
                f"{len(missing)} of {len(planned)} shards are made by {launch.label}: {self.folder}"
            )
            with closing(finished):
                for block in planned:
                    if block in missing:
                        next(finished)
                        deadline = (
                            time.monotonic() + VISIBILITY_S
                        )  # this machine may see it later than another
                        while not self._finished(block) and time.monotonic() < deadline:
                            time.sleep(1.0)
                    for row, episode in self._read_shard(block, remaining):
                        yield row, episode
                        del remaining[row.seed]
                        if wanted is not None:
                            wanted -= row.success
                        if wanted == 0:
                            break
                    if remaining.keys().isdisjoint(block):
                        shutil.rmtree(self.folder / _name(block))
        if not existing_shards(self.folder):
            shutil.rmtree(self.folder)

    def shard_for(self, block: range) -> "Shards":
        """The shard of one block, as a value for the process that makes it."""
        parent = self.cell.experiment
        experiment = replace(
            parent,
            tasks=(self.cell.task,),
            constraint_sets=(self.cell.constraint_set,),
            stages=("generate",),
            out=self.folder / _name(block),
            seed=block.start,
            episodes=len(block),
            workers=1,
            recordings=0,
            wandb="disabled",
            launch=replace(parent.launch, engine=LOCAL, address=None, options=None),
        )
        return replace(self, cell=replace(self.cell, experiment=experiment))

    def _rows(self, block: range) -> dict[int, GenerationRow]:
        path = self.shard_for(block).cell.generation_path
        return {row.seed: row for row in known_rows(path, GenerationRow)}

    def _finished(self, block: range) -> bool:
        return self._rows(block).keys() == {*block}

    def _read_shard(self, block: range, remaining: Container[int]) -> Iterator[Attempt]:
        cell = self.shard_for(block).cell
        with artifact_lock(cell.generation_path):  # waits for the process that makes it
            rows = self._rows(block)
            store = Store.open(cell.data_path, {**self.identity, "first_seed": block.start})
            stored = {seed: index for index, seed in enumerate(store.seeds.tolist())}
            if {*rows} != {*block} or {*stored} != {seed for seed in rows if rows[seed].success}:
                raise StageError(
                    f"shard {cell.experiment.out} has rows of the seeds {sorted(rows)} and demonstrations of "
                    f"{sorted(stored)}; expected a row of every seed from {block[0]} to {block[-1]}, and a "
                    "demonstration of each that succeeded; delete it and run the same command again"
                )
            for seed in (seed for seed in block if seed in remaining):
                yield rows[seed], store.episode(stored[seed]) if seed in stored else None


def existing_shards(folder: Path) -> list[range]:
    """The seeds of each existing shard, finished or not, in their order."""
    matches = (_NAME.fullmatch(path.name) for path in folder.iterdir())
    return sorted((range(int(match[1]), int(match[2]) + 1) for match in matches if match), key=lambda b: b[0])


def plan_shards(
    seeds: Sequence[int], existing: Sequence[range], size: int, wanted: int | None
) -> list[range]:
    """The shards of ascending `seeds`, or the first `wanted`: existing ones, and new ones of up to `size`."""
    new = {seed for seed in seeds if not any(seed in block for block in existing)}
    needed, covered = len(seeds) if wanted is None else min(wanted, len(seeds)), 0
    planned: list[range] = []
    while covered < needed:
        first = last = seeds[covered]
        while {last, last + 1} <= new and last + 1 - first < size:
            last += 1
        containing = [block for block in existing if first in block]
        planned.append(max(containing, key=lambda block: block[-1], default=range(first, last + 1)))
        covered += sum(seed in planned[-1] for seed in seeds[covered:])
    return planned


def _name(block: range) -> str:
    return f"{block[0]}-{block[-1]}"


def make_shard(shard: Shards, expected: Mapping[str, Any]) -> None:
    """Makes a shard on the engine's machine. Raises StageError if its identity there is not `expected`."""
    host, folder = f"machine {socket.gethostname()}", shard.cell.experiment.out.parent
    if not (folder / IDENTITY_FILE).is_file():
        raise StageError(
            f"{host} does not see {folder}; `out` has to be on a file system that all machines share"
        )
    if differences := find_differences(shard.identity, expected):
        raise StageError(
            f"{host} would make other demonstrations ({'; '.join(differences)}); all machines need the same "
            "code and the same assets"
        )
    shard.generate(shard.cell)
