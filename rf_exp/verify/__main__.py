"""Verify published rows of demonstrations: generate ten of each file again and compare the results.

python -m rf_exp.verify results/expert/lift_barrier.tsv
python -m rf_exp.verify results/ablation/take_photo/*.tsv --seeds 20

Success by both criteria, steps, attempts, violations and contacts are compared. Differences are printed with
both values, and the exit code is then 1. The same code makes the same rows; another version of the generator
may plan differently, and another kind of processor may differ in the last bit of a number.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from rf_exp.command import guarded
from rf_exp.errors import StageError
from rf_exp.progress import console
from rf_exp.texts import LONGEST_LINE, printable
from rf_exp.verify import EXPERIMENTS, differences, made_again, published


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m rf_exp.verify", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "files", type=Path, nargs="+", metavar="ROWS", help="published rows: results/**/*.tsv"
    )
    parser.add_argument("--seeds", type=int, default=10, help="of each file (10)")
    given = parser.parse_args()
    wrong = 0
    for path in given.files:
        rows = published(path, given.seeds)
        with tempfile.TemporaryDirectory(prefix="rf_exp-verify-") as folder:
            experiment = next((name for name in EXPERIMENTS if name in path.resolve().parts), None)
            again = made_again(rows, Path(folder), experiment)
        found = list(differences(rows, again))
        for what in found:
            console.print(printable(f"{path}: {what}", LONGEST_LINE))
        told, now = rows[0].generator, again[0].generator
        by = f"generator {now}" + (f", told by {told}" if told != now else "")
        if not found:
            console.print(f"{path}: {len(rows)} rows came out as told ({by})")
        elif told != now:
            console.print(f"{path}: told by generator {told}, made again by {now}")
        wrong += bool(found)
    if wrong:
        raise StageError(f"{wrong} of {len(given.files)} files did not come out as told; see above")


if __name__ == "__main__":
    sys.exit(guarded(main))
