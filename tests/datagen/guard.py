"""Watches what a process does while it reads what a stranger wrote."""

import sys

from rf_exp.constraints import RoboChecker
from rf_exp.datagen.brain import BadAnswer, from_json
from rf_exp.errors import ArgumentError
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet

FULL = ConstraintSet("full")


class Guard:
    """Notes whatever is executed, opened for writing or started while it is on."""

    WATCHED = frozenset(
        {"exec", "compile", "os.system", "os.exec", "os.posix_spawn", "subprocess.Popen", "import"}
    )

    def __init__(self) -> None:
        self.on, self.seen = False, []
        sys.addaudithook(self._hook)  # cannot be taken off again, so it is switched

    def _hook(self, event, arguments):
        if self.on and (event in self.WATCHED or (event == "open" and "w" in str(arguments[1]))):
            self.seen.append((event, arguments))

    def prepare(self, sound: str, task: Task) -> None:
        """Loads what is loaded at first use, and proves that it does see what is executed."""
        RoboChecker(task, from_json(sound, task), FULL)
        self.on = True
        eval("1 + 1")
        self.on = False
        assert {event for event, _ in self.seen} >= {"compile", "exec"}
        self.seen.clear()

    def digest(self, text: str, task: Task) -> str:
        """What becomes of an answer up to the check code: a proposal with checks, or a clear reason."""
        self.on = True
        try:
            proposal = from_json(text, task)
            RoboChecker(task, proposal, FULL)
            reason = "understood"
        except (BadAnswer, ArgumentError) as error:
            reason = str(error)
        finally:
            self.on = False
        assert reason and not self.seen
        return reason
