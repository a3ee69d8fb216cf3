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

from rf_exp.store import Damage, DamagedStore, Store, empty_like


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("store", type=Path)
    parser.add_argument("--flips", type=int, default=100, help="bytes, one after the other")
    parser.add_argument("--states", action="store_true", help="without pictures")
    args = parser.parse_args()
    source = Store.open(args.store)
    with TemporaryDirectory(prefix="rf_exp-") as folder:
        path = Path(folder) / "again.zarr"
        print(json.dumps(costs(source, path, args.states) | lost_episodes(path, args.flips)))


def costs(source: Store, path: Path, states: bool) -> dict[str, float]:
    """Size, and CPU times of writing an episode, of opening the store, and of reading all states."""
    without_pictures = {"cameras": [], "depth": False, "labels": []} if states else {}
    empty_like(path, {**source.attrs, **without_pictures})
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


def lost_episodes(path: Path, flips: int) -> dict[str, float]:
    """Numbers of episodes that are unreadable after a bit flip, mean and largest."""
    rng = random.Random(0)
    files = sorted(file for file in path.rglob("c/**/*") if file.is_file())
    sizes = [file.stat().st_size for file in files]
    episodes = len(Store.open(path))
    losses = []
    for file in rng.choices(files, sizes, k=flips):
        original, name = file.read_bytes(), "/".join(file.relative_to(path).parts[:2])
        index = rng.randrange(len(original))
        file.write_bytes(
            original[:index] + bytes([original[index] ^ 1 << rng.randrange(8)]) + original[index + 1 :]
        )
        losses.append(episodes - readable(path, name))
        file.write_bytes(original)
    return {"episodes": episodes, "lost_mean": round(float(np.mean(losses)), 2), "lost_most": max(losses)}


def readable(path: Path, name: str) -> int:
    """Number of readable episodes of a store in which the array `name` is damaged."""
    with TemporaryDirectory() as frame:
        damaged, count = DamagedStore(path, Path(frame)), 0
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
