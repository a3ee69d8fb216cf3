"""`python -m rf_exp.ablation --out outputs`: writes tables and report again, from the result rows alone."""

import argparse
import sys
from pathlib import Path

from rf_exp.ablation.formats import show
from rf_exp.ablation.report import publish
from rf_exp.ablation.tables.inputs import configured
from rf_exp.errors import ArgumentError, RfError
from rf_exp.progress import console, error_console


def main(arguments: list[str] | None = None) -> int:
    """Returns exit code 0 done, 1 failed, 2 a wrong argument; the reason is the last line of output."""
    parser = argparse.ArgumentParser("python -m rf_exp.ablation", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder with results/")
    out: Path = parser.parse_args(arguments).out
    try:
        if not (out / "results").is_dir():
            raise ArgumentError(f"--out is {out}; expected a folder with result rows in {out}/results")
        tables, report = publish(out, configured())
    except RfError as error:
        error_console.print(f"error: {error}")
        return 2 if isinstance(error, ArgumentError) else 1
    printed_notes = set[str]()
    for table in tables.values():
        if table.measured:
            show(table, console, printed_notes)
    console.print(f"tables in {out / 'tables'}, report in {report}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
