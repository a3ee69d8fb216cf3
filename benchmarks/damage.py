"""Damage by one flipped bit in a store, which its small chunks limit, and the cost of the store.

    python benchmarks/damage.py outputs/data/lift_barrier/full/fast.zarr [--flips 100] [--states]

Writes the episodes of a store again, measures the cost, and flips random bits, one at a time in an otherwise
intact store; `--states` leaves the pictures out. Times are CPU times. The last line is JSON.
"""

import argparse
import json
import random
import time
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rf_exp.store import Damage, Damaged, Store, empty_like


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("store", type=Path)
    parser.add_argument("--flips", type=int, default=100, help="bytes, one after the other")
    parser.add_argument("--states", action="store_true", help="without pictures")
    given = parser.parse_args()
    source = Store.open(given.store)
    with TemporaryDirectory(prefix="rf_exp-") as folder:
        path = Path(folder) / "again.zarr"
        print(json.dumps(costs(source, path, given.states) | lost(path, given.flips)))


def costs(source: Store, path: Path, states: bool) -> dict[str, float]:
    """Size, and CPU times of writing an episode, of opening the store, and of reading all states."""
    shown = {"cameras": [], "depth": False, "labels": []} if states else {}
    empty_like(path, {**source.attrs, **shown})
    episodes = [source.episode(index) for index in range(len(source))]
    began_s = time.process_time()
    with Store.open(path, writable=True) as store:
        for episode in episodes:
            store.append(replace(episode, images={}, extras={}) if states else episode)
    wrote_s = time.process_time()
    store = Store.open(path)
    opened_s = time.process_time()
    for name in ("qpos", "qvel", "action", "executed", "poses", "subgoal", "judged", "certificates"):
        getattr(store, name)
    return {
        "MB": round(sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) / 1e6, 3),
        "write_ms_an_episode": round((wrote_s - began_s) * 1e3 / len(source)),
        "open_ms": round((opened_s - wrote_s) * 1e3),
        "read_ms": round((time.process_time() - opened_s) * 1e3),
    }


def lost(path: Path, flips: int) -> dict[str, float]:
    """Numbers of episodes that are unreadable after a bit flip, mean and largest."""
    draw = random.Random(0)
    files = sorted(file for file in path.rglob("c/**/*") if file.is_file())
    sizes = [file.stat().st_size for file in files]
    episodes = len(Store.open(path))
    found = []
    for file in draw.choices(files, sizes, k=flips):
        whole, name = file.read_bytes(), "/".join(file.relative_to(path).parts[:2])
        at = draw.randrange(len(whole))
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << draw.randrange(8)]) + whole[at + 1 :])
        found.append(episodes - readable(path, name))
        file.write_bytes(whole)
    return {"episodes": episodes, "lost_mean": round(float(np.mean(found)), 2), "lost_most": max(found)}


def readable(path: Path, name: str) -> int:
    """Number of readable episodes of a store in which the array `name` is damaged."""
    with TemporaryDirectory() as frame:
        damaged, count = Damaged(path, Path(frame)), 0
        for index, (start, end) in enumerate(pairwise([0, *damaged.ends])):
            with suppress(Damage):
                if name.startswith("data/"):
                    damaged._read(name, start, end)
                else:
                    damaged.episode(index)
                count += 1
    return count


if __name__ == "__main__":
    main()
