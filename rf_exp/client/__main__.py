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
    check_parser = commands.add_parser("check", help="query a server and report problems of its answers")
    check_parser.add_argument("server", help="ws://host:port")
    check_parser.add_argument(
        "--connect_s", type=float, default=10.0, help="time limit of connecting, in s (10)"
    )
    check_parser.add_argument(
        "--answer_s", type=float, default=120.0, help="time limit of each answer, in s (120)"
    )
    describe_parser = commands.add_parser("describe", help="list the keys of an observation")
    for subparser in (check_parser, describe_parser):
        _add_observation_arguments(subparser)
    arguments = parser.parse_args()
    try:
        contract = _contract(arguments)
    except ValueError as error:
        parser.error(str(error))
    if arguments.command == "describe":
        for key, (shape, dtype, meaning) in contract.entries.items():
            print(shown(f"{key:28} {dtype:8} {'x'.join(map(str, shape)):12} {meaning}"))
        return 0
    return _check(arguments, contract)


def _check(arguments: argparse.Namespace, contract: Contract) -> int:
    try:
        report = check(arguments.server, contract, arguments.connect_s, arguments.answer_s)
    except ServerFailed as error:
        print(shown(f"wrong: {error}"), file=sys.stderr)
        return 1
    for note in report.notes:
        print(shown(f"note: {note}"))
    first, *later = report.seconds
    steps = sorted(set(report.steps))
    summary = (
        f"{len(report.steps)} answers can be used: chunks of {' or '.join(map(str, steps))} steps, "
        f"{steps[0] / CONTROL_HZ:g} s of motion; the first answer took {first:.2f} s, the others "
        f"{sum(later) / len(later):.2f} s"
    )
    print(printable(summary))
    return 0


def _add_observation_arguments(parser: argparse.ArgumentParser) -> None:
    arms_group = parser.add_mutually_exclusive_group(required=True)
    arms_group.add_argument("--task", help="task of the suite, which defines arms and objects")
    arms_group.add_argument("--arms", type=int, help="number of arms, for any other task")
    parser.add_argument("--state", default="joints", help=f"{' | '.join(STATES)} (joints)")
    parser.add_argument("--cameras", default="all", help=f"{' | '.join(CAMERAS)} (all)")
    parser.add_argument("--width", type=int, default=320, help="of pictures, in pixels (320)")
    parser.add_argument("--height", type=int, default=240, help="(240)")
    defaults = {field.name: field.default for field in fields(Contract) if field.default is not MISSING}
    for name in SWITCHES:
        parser.add_argument(
            f"--{name}",
            action=argparse.BooleanOptionalAction,
            default=defaults[name],
            help=f"include {name} in observations",
        )


def _contract(arguments: argparse.Namespace) -> Contract:
    names = ("state", "cameras", "width", "height", *SWITCHES)
    options = {name: getattr(arguments, name) for name in names}
    return (
        Contract(arguments.arms, **options)
        if arguments.task is None
        else Contract.of_task(arguments.task, **options)
    )


if __name__ == "__main__":
    sys.exit(main())
