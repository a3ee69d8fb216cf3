"""`python -m rf_exp.ablation --out outputs`: writes tables and report again, from the result rows alone."""

import argparse
import sys
from pathlib import Path

from rf_exp.ablation.formats import show
from rf_exp.ablation.report import publish
from rf_exp.ablation.tables.known import configured
from rf_exp.errors import ArgumentError, RfError
from rf_exp.progress import complaints, console


def main(arguments: list[str] | None = None) -> int:
    """Returns exit code 0 done, 1 failed, 2 a wrong argument; the reason is the last line of output."""
    parser = argparse.ArgumentParser("python -m rf_exp.ablation", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder with results/")
    out: Path = parser.parse_args(arguments).out
    try:
        if not (out / "results").is_dir():
            raise ArgumentError(f"--out is {out}; expected a folder with result rows in {out}/results")
        built, report = publish(out, configured())
    except RfError as error:
        complaints.print(f"error: {error}")
        return 2 if isinstance(error, ArgumentError) else 1
    said = set[str]()
    for table in built.values():
        if table.measured:
            show(table, console, said)
    console.print(f"tables in {out / 'tables'}, report in {report}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
