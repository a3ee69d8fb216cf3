"""Progress display of long work: a bar on a terminal, a line now and then elsewhere.

Both show how much is done, the rate and, where work can fail, the success so far. A narrow terminal cuts long
texts, but never the counts and the remaining time.
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

PRINT_INTERVAL_S = 20.0
BAR_WIDTH = 12  # characters: a title, counts, time and a note fit beside it into 80


class Screen(Console):
    """The console for all output of the suite: external text cannot be markup or control the terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, soft_wrap=True, markup=False, emoji=False, **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints as rich does; cuts the middle of a text that is too long before it is laid out."""
        super().print(*(shown(item) if isinstance(item, str) else item for item in objects), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Renders as rich does, and makes the text printable."""
        for part in super().render(renderable, options):
            yield part if part.control else Segment(shown(part.text), part.style)


console = Screen()
error_console = Screen(stderr=True)  # errors, kept apart from output that programs read


class Progress:
    """Progress of one job: `with Progress("generate", 50, "episodes") as p: p.advance(note="49/50")`."""

    def __init__(self, title: str, total: int, unit: str, done: int = 0) -> None:
        self._title, self._total, self._unit = title, total, unit
        self._done = self._at_start = done
        self._start_s = self._last_print_s = time.perf_counter()
        self._note, self._last_printed = "", -1  # current note; count on the last printed line
        self._bar = _bar(title, total, done) if sys.stdout.isatty() else None

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
        if kind is None:
            self._print_line()

    def advance(self, steps: int = 1, note: str = "", total: int | None = None) -> None:
        """Adds finished work; `note` and `total`, where given, replace the last ones."""
        self._done += steps
        self._total = total or self._total
        self._note = note or self._note
        if self._bar is not None:
            rate = f"{self._rate():.3g} {self._unit}/s"
            text = f"{self._note}, {rate}" if self._note else rate
            self._bar.update(self._bar.task_ids[0], completed=self._done, total=self._total, note=text)
        elif time.perf_counter() - self._last_print_s > PRINT_INTERVAL_S:
            self._print_line()

    def _rate(self) -> float:
        return (self._done - self._at_start) / max(time.perf_counter() - self._start_s, 1e-9)

    def _print_line(self) -> None:
        if self._done in (self._last_printed, self._at_start):
            return
        self._last_print_s, self._last_printed = time.perf_counter(), self._done
        note = f", {self._note}" if self._note else ""
        if self._bar is None or self._done >= self._total:
            done = f"{self._done}/{self._total} {self._unit}"
            console.print(f"{self._title}: {done} at {self._rate():.3g}/s{note}")


class _EllipsisColumn(TextColumn):
    """Text on one line, whose end is cut where it would push the counts off the screen."""

    def render(self, task: Task) -> Text:
        words = super().render(task)
        words.no_wrap, words.overflow = True, "ellipsis"
        return words


def _bar(title: str, total: int, done: int) -> Bar:
    columns = (  # rich narrows no_wrap columns only after the others
        _EllipsisColumn("{task.description}", markup=False, table_column=Column()),
        BarColumn(BAR_WIDTH, table_column=Column(no_wrap=True)),
        MofNCompleteColumn(table_column=Column(no_wrap=True)),
        TimeRemainingColumn(compact=True, table_column=Column(no_wrap=True)),
        _EllipsisColumn("{task.fields[note]}", markup=False, table_column=Column()),
    )
    bar = Bar(*columns, console=console)
    bar.add_task(title, total=total, completed=done, note="")
    return bar
