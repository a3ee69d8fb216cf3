"""The console script `rf-exp`: runs the experiment, or the command named by the first argument.

rf-exp task=lift_barrier    as python -m rf_exp.run task=lift_barrier
rf-exp doctor               as python -m rf_exp.doctor
"""

import runpy
import sys
from difflib import get_close_matches

from rf_exp.texts import shown

COMMANDS = ("client", "compose", "data", "demonstration", "doctor", "gallery", "laws", "rescue", "verify")


def main() -> int:
    """Runs the command that the arguments name; its exit code."""
    if sys.argv[1:] and sys.argv[1] in COMMANDS:
        # Nothing else is imported for it: the doctor also works where packages are missing.
        runpy.run_module(f"rf_exp.{sys.argv.pop(1)}", run_name="__main__", alter_sys=True)
        return 0
    if sys.argv[1:] and (meant := get_close_matches(sys.argv[1], COMMANDS, 1, 0.7)):
        refusal = f"wrong argument: {sys.argv[1]!r} is not understood; did you mean {meant[0]}?"
        print(shown(refusal), file=sys.stderr)
        return 2
    from rf_exp.run import command

    return command()
