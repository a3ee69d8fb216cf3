"""Audit of this process while it parses untrusted answers."""

import sys

from rf_exp.constraints import RoboChecker
from rf_exp.datagen.brain import BadAnswer, from_json
from rf_exp.errors import ArgumentError
from rf_exp.tasks import Task
from rf_exp.types import ConstraintSet

FULL = ConstraintSet("full")


class Guard:
    """Audit hook that records executed code, files opened for writing and new processes while `on` is set."""

    WATCHED = frozenset(
        {"exec", "compile", "os.system", "os.exec", "os.posix_spawn", "subprocess.Popen", "import"}
    )

    def __init__(self) -> None:
        self.on, self.seen = False, []
        sys.addaudithook(self._hook)  # hooks cannot be removed, hence the switch `on`

    def _hook(self, event, arguments):
        if self.on and (event in self.WATCHED or (event == "open" and "w" in str(arguments[1]))):
            self.seen.append((event, arguments))

    def prepare(self, valid_answer: str, task: Task) -> None:
        """Triggers lazy imports with a valid answer, and asserts that the hook records executed code."""
        RoboChecker(task, from_json(valid_answer, task), FULL)
        self.on = True
        eval("1 + 1")
        self.on = False
        assert {event for event, _ in self.seen} >= {"compile", "exec"}
        self.seen.clear()

    def digest(self, text: str, task: Task) -> str:
        """Parses an answer and compiles its checks; returns 'understood' or the error message."""
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
