"""Cost of exports of a store: minutes, core minutes, and size relative to the store.

    python benchmarks/export.py outputs/data/lift_barrier/full/fast.zarr [--formats lerobot-video]

Writes each export into a temporary folder, by the same code as `python -m rf_exp.data export`. The last line
is JSON.
"""

import argparse
import json
import os
import time
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from rf_exp.data.__main__ import FORMATS, export, mib, validate
from rf_exp.store import Store

WAYS = [f"{form}-{way}" for form in FORMATS for way in import_module(f"rf_exp.data.{form}").PICTURES]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("store", type=Path)
    parser.add_argument("--formats", nargs="+", choices=WAYS, default=WAYS)
    args = parser.parse_args()
    store, began = Store.open(args.store), now()
    validate([args.store])
    result: dict[str, dict[str, float]] = {
        "store": {"MiB": mib(args.store), "episodes": len(store), "steps": store.steps},
        "validate": since(began),
    }
    with TemporaryDirectory(prefix="rf_exp-") as folder:
        for name in args.formats:
            form, _, pictures = name.partition("-")
            target, began = Path(folder) / name, now()
            export(args.store, target, form, pictures)
            size = {"MiB": mib(target), "times_the_store": round(mib(target) / mib(args.store), 2)}
            result[name] = since(began) | size
    print(json.dumps(result))


def now() -> tuple[float, float]:
    """Seconds of wall time, and CPU seconds of this process and its children."""
    return time.perf_counter(), sum(os.times()[:4])


def since(began: tuple[float, float]) -> dict[str, float]:
    minutes = [round((end - start) / 60, 2) for start, end in zip(began, now(), strict=True)]
    return dict(zip(("minutes", "core_minutes"), minutes, strict=True))


if __name__ == "__main__":
    main()
