"""Check of a policy server with synthetic observations: whether the suite could use its answers.

check ws://gpu-machine:8000 --task lift_barrier
check ws://gpu-machine:8000 --arms 3 --cameras local --width 128 --height 96
describe --task take_photo --state full

`check` exits with 0 if every answer can be used, else with 1 and the problem; `describe` lists the keys of an
observation. See docs/serving.md.
"""

import argparse
import sys
from dataclasses import MISSING, fields

from ..texts import printable, shown
from .checking import check
from .connection import ServerFailed
from .contract import CAMERAS, CONTROL_HZ, STATES, Contract

NAME = "python -m rf_exp.client" if __package__ == "rf_exp.client" else "rf_exp-client"
SWITCHES = ("pictures", "depth", "segmentation", "calibration", "language")


def main() -> int:
    """Runs the command and returns its exit code."""
    parser = argparse.ArgumentParser(
        NAME, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    checks = commands.add_parser("check", help="ask a server, and say what is wrong with its answers")
    checks.add_argument("server", help="ws://host:port")
    checks.add_argument("--connect_s", type=float, default=10.0, help="how long it may take to connect (10)")
    checks.add_argument("--answer_s", type=float, default=120.0, help="and to answer (120)")
    describes = commands.add_parser("describe", help="list the keys of an observation")
    for each in (checks, describes):
        _observations(each)
    given = parser.parse_args()
    try:
        contract = _contract(given)
    except ValueError as error:
        parser.error(str(error))
    if given.command == "describe":
        for key, (shape, dtype, holds) in contract.entries.items():
            print(shown(f"{key:28} {dtype:8} {'x'.join(map(str, shape)):12} {holds}"))
        return 0
    return _check(given, contract)


def _check(given: argparse.Namespace, contract: Contract) -> int:
    try:
        report = check(given.server, contract, given.connect_s, given.answer_s)
    except ServerFailed as error:
        print(shown(f"wrong: {error}"), file=sys.stderr)
        return 1
    for note in report.notes:
        print(shown(f"note: {note}"))
    first, *later = report.seconds
    steps = sorted(set(report.steps))
    said = (
        f"{len(report.steps)} answers can be used: chunks of {' or '.join(map(str, steps))} steps, "
        f"{steps[0] / CONTROL_HZ:g} s of motion; the first answer took {first:.2f} s, the others "
        f"{sum(later) / len(later):.2f} s"
    )
    print(printable(said))
    return 0


def _observations(parser: argparse.ArgumentParser) -> None:
    whose = parser.add_mutually_exclusive_group(required=True)
    whose.add_argument("--task", help="of the suite, which says how many arms there are, and which objects")
    whose.add_argument("--arms", type=int, help="for any other task")
    parser.add_argument("--state", default="joints", help=f"{' | '.join(STATES)} (joints)")
    parser.add_argument("--cameras", default="all", help=f"{' | '.join(CAMERAS)} (all)")
    parser.add_argument("--width", type=int, default=320, help="of pictures, in pixels (320)")
    parser.add_argument("--height", type=int, default=240, help="(240)")
    usual = {each.name: each.default for each in fields(Contract) if each.default is not MISSING}
    for name in SWITCHES:
        does = "do" if usual[name] else "do not"
        parser.add_argument(
            f"--{name}",
            action=argparse.BooleanOptionalAction,
            default=usual[name],
            help=f"observations {does}",
        )


def _contract(given: argparse.Namespace) -> Contract:
    names = ("state", "cameras", "width", "height", *SWITCHES)
    options = {name: getattr(given, name) for name in names}
    return Contract(given.arms, **options) if given.task is None else Contract.of_task(given.task, **options)


if __name__ == "__main__":
    sys.exit(main())
