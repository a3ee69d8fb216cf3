"""Progress of long work: a bar on a terminal, a line now and then elsewhere.

Both show how much is done, the rate and, where things can fail, the success so far. On a narrow terminal what
is too long is cut, but never the counts and the time that is left.
"""

import sys
import time
from collections.abc import Iterable
from typing import Any, Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Task, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.segment import Segment
from rich.table import Column
from rich.text import Text

from rf_exp.texts import shown

LINE_EVERY_S = 20.0
BAR_WIDTH = 12  # characters: a title, counts, time and a note fit beside it into 80


class Screen(Console):
    """Where alone the suite prints: words of others are no markup there, nor orders to the terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, soft_wrap=True, markup=False, emoji=False, **options)

    def print(self, *told: Any, **how: Any) -> None:
        """As rich does; of a text that is too long its ends, before it is laid out."""
        super().print(*(shown(each) if isinstance(each, str) else each for each in told), **how)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """As rich lays it out; of the text of others what can be shown."""
        for part in super().render(renderable, options):
            yield part if part.control else Segment(shown(part.text), part.style)


console = Screen()
complaints = Screen(stderr=True)  # errors: what programs that read the output are not to see


class Progress:
    """`with Progress("generate", 50, "episodes") as p: p.advance(note="49/50 succeeded")`."""

    def __init__(self, title: str, total: int, unit: str, done: int = 0) -> None:
        self._title, self._total, self._unit = title, total, unit
        self._done = self._at_start = done
        self._began = self._said = time.perf_counter()
        self._note, self._told = "", -1  # what was said last, so that nothing is said twice
        self._bar = _bar(title, total, done) if sys.stdout.isatty() else None

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
        if kind is None:
            self._say()

    def advance(self, steps: int = 1, note: str = "", total: int | None = None) -> None:
        """Some more work is done; `note` replaces the last one, `total` what is known of the whole."""
        self._done += steps
        self._total = total or self._total
        self._note = note or self._note
        if self._bar is not None:
            rate = f"{self._rate():.3g} {self._unit}/s"
            text = f"{self._note}, {rate}" if self._note else rate
            self._bar.update(self._bar.task_ids[0], completed=self._done, total=self._total, note=text)
        elif time.perf_counter() - self._said > LINE_EVERY_S:
            self._say()

    def _rate(self) -> float:
        return (self._done - self._at_start) / max(time.perf_counter() - self._began, 1e-9)

    def _say(self) -> None:
        if self._done in (self._told, self._at_start):
            return
        self._said, self._told = time.perf_counter(), self._done
        note = f", {self._note}" if self._note else ""
        if self._bar is None or self._done >= self._total:
            done = f"{self._done}/{self._total} {self._unit}"
            console.print(f"{self._title}: {done} at {self._rate():.3g}/s{note}")


class _Shortened(TextColumn):
    """Words on one line, whose end is cut where they would push the counts off the screen."""

    def render(self, task: Task) -> Text:
        words = super().render(task)
        words.no_wrap, words.overflow = True, "ellipsis"
        return words


def _bar(title: str, total: int, done: int) -> Bar:
    columns = (  # those of a table that are not wrapped are not made narrower while others can be
        _Shortened("{task.description}", markup=False, table_column=Column()),
        BarColumn(BAR_WIDTH, table_column=Column(no_wrap=True)),
        MofNCompleteColumn(table_column=Column(no_wrap=True)),
        TimeRemainingColumn(compact=True, table_column=Column(no_wrap=True)),
        _Shortened("{task.fields[note]}", markup=False, table_column=Column()),
    )
    bar = Bar(*columns, console=console)
    bar.add_task(title, total=total, completed=done, note="")
    return bar
