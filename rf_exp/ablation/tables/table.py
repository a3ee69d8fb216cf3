"""Tables: columns of one kind of cell each, and lines of cells, which format themselves."""

from dataclasses import dataclass, fields, replace
from typing import ClassVar

from rf_exp.ablation.statistics import Estimate
from rf_exp.errors import unknown_choice
from rf_exp.texts import markdown, one_line

MISSING = "missing"
CLEAN = "without a violation"  # generation: at the first attempt
Interval = tuple[float, float]
LATEX_NAMES = {"<": "less", ">": "greater", "\\": "backslash", "~": "asciitilde", "^": "asciicircum"}
LATEX = str.maketrans(
    {letter: rf"\text{name}{{}}" for letter, name in LATEX_NAMES.items()}
    | {letter: rf"\{letter}" for letter in "&%$#_{}"}
)


@dataclass(frozen=True)
class Text:
    """A text, or a number that is not compared."""

    unit: ClassVar = "text"
    value: str

    def markdown(self) -> str:
        return markdown.cell(self.value)

    def latex(self) -> str:
        return escape_latex(self.value)

    def csv(self) -> dict[str, object]:
        return {"status": "text", "value": self.value, "n": 0}


@dataclass(frozen=True)
class Figure:
    """Base of all figures. `value` None means: nothing was measured yet, or `placeholder` takes its place."""

    unit: ClassVar[str]
    value: float | None = None
    n: int = 0  # attempts behind it; for a length successes
    interval: Interval | None = None  # 95 %
    note: str = ""
    version: str = ""  # of the success criteria
    placeholder: str = ""  # text in place of a value, such as `no success`

    @staticmethod
    def number(value: float, sign: bool = True) -> str:
        """A value in the unit of the cell: `97.5 %`, `80.7`; without `sign` `97.5`."""
        return f"{100 * value:.1f}" + " %" * sign

    @property
    def figure(self) -> str:
        """Our figure alone: `97.5 %`, `80.7`, `missing`."""
        return (self.placeholder or MISSING) if self.value is None else self.number(self.value)

    @property
    def missing(self) -> bool:
        return self.value is None and not self.placeholder

    @property
    def details(self) -> list[str]:
        """Details of the figure: first its interval, with the sample size."""
        size = f"n={self.n}" if self.n else ""
        spread = " ".join(filter(None, [self.bracketed(self.interval), size]))
        return [spread] if spread else []

    def bracketed(self, interval: Interval | None) -> str:
        """`[93.1, 99.1]`; empty without one."""
        return f"[{', '.join(self.number(end, sign=False) for end in interval)}]" if interval else ""

    def markdown(self) -> str:
        return "".join(f"**{text}**" if strong else text for text, strong in self._spans())

    def latex(self) -> str:
        spans = ((escape_latex(text), strong) for text, strong in self._spans())
        return "".join(rf"\textbf{{{text}}}" if strong else text for text, strong in spans)

    def csv(self) -> dict[str, object]:
        """Unformatted numbers: rates in [0, 1], lengths in control steps."""
        low, high = self.interval or (None, None)
        status = MISSING if self.missing else "measured"
        values = {
            "status": status,
            "value": self.placeholder or self.value,
            "low": low,
            "high": high,
            "n": self.n,
        }
        base_fields = {field.name for field in fields(Figure)}
        own_fields = {name: value for name, value in vars(self).items() if name not in base_fields}
        return {**values, "version": self.version, "note": self.note, **own_fields}

    def _spans(self) -> list[tuple[str, bool]]:
        """(text, whether it is emphasised) for the figure and its details."""
        if self.value is None:
            return [(self.figure, False)]
        return [(self.figure, True), *((f", {text}", False) for text in self.details)]


@dataclass(frozen=True)
class Rate(Figure):
    """A share of attempts that succeeded, in [0, 1], beside the paper's."""

    unit: ClassVar = "rate"
    paper: float | None = None
    success_paper: float | None = None  # by the paper's own criterion
    clean: Estimate | None = None  # strict success without a violation on the way

    @property
    def details(self) -> list[str]:
        success_paper = self.success_paper
        paper_criterion = (
            [] if success_paper in (None, self.value) else [f"paper's criterion {self.number(success_paper)}"]
        )
        return [*super().details, *paper_criterion]

    @property
    def clean_figure(self) -> tuple[str, str]:
        """The rate without a violation and its interval; empty without it."""
        if self.clean is None:
            return "", ""
        return self.number(self.clean.value), self.bracketed(self.clean.interval)

    @property
    def clean_if_different(self) -> Estimate | None:
        """The rate without a violation, where it differs from the rate."""
        return self.clean if self.clean is not None and self.clean.value != self.value else None

    @property
    def estimate(self) -> Estimate | None:
        """The figure with its interval, where there is one."""
        if self.value is None or self.interval is None:
            return None
        return Estimate(self.value, *self.interval, self.n)

    def csv(self) -> dict[str, object]:
        clean = self.clean
        rate, low, high = (clean.value, *clean.interval) if clean else (None, None, None)
        return {**super().csv(), "clean": rate, "clean_low": low, "clean_high": high}

    def _spans(self) -> list[tuple[str, bool]]:
        spans = super()._spans()
        if self.clean is None or self.value is None:
            return spans
        rate, interval = self.clean_figure
        return [*spans[:2], (f", {CLEAN} ", False), (rate, True), (f" {interval}", False), *spans[2:]]


@dataclass(frozen=True)
class Length(Figure):
    """Mean control steps of the successes, beside the paper's."""

    unit: ClassVar = "steps"
    paper: float | None = None

    @staticmethod
    def number(value: float, sign: bool = True) -> str:
        return f"{value:.1f}" if value < 1000 else f"{value:.0f}"


@dataclass(frozen=True)
class Violations(Figure):
    """The share of attempts with a violation, in [0, 1]; of the same sample as the figure before it."""

    unit: ClassVar = "violations"
    mean_violations: float | None = None  # per attempt

    @property
    def details(self) -> list[str]:
        average = "" if self.mean_violations is None else f"mean {self.mean_violations:.2f}"
        return [text for text in (self.bracketed(self.interval), average) if text]


@dataclass(frozen=True)
class Difference(Figure):
    """The difference of two rates over the same scenes, in [-1, 1]; `n` counts these scenes."""

    unit: ClassVar = "difference"
    p: float | None = None  # of McNemar's exact test, two-sided

    @staticmethod
    def number(value: float, sign: bool = True) -> str:
        return f"{100 * value:+.1f}" + " points" * sign

    @property
    def details(self) -> list[str]:
        return [*super().details, *([] if self.p is None else [p_value(self.p)])]


@dataclass(frozen=True)
class Score(Figure):
    """Mean progress of attempts, from 0 to 1 (success)."""

    unit: ClassVar = "score"

    @staticmethod
    def number(value: float, sign: bool = True) -> str:
        return f"{value:.2f}"


@dataclass(frozen=True)
class Share(Figure):
    """A share of attempts, in [0, 1], of which the paper has no figure."""

    unit: ClassVar = "share"


Cell = Rate | Length | Violations | Difference | Score | Share | Text


def p_value(p: float) -> str:
    """`p=0.031`; below a thousandth `p<0.001`."""
    return "p<0.001" if p < 0.001 else f"p={p:.2g}" if p < 0.1 else f"p={p:.2f}"


def escape_latex(text: str) -> str:
    return one_line(text).translate(LATEX)


@dataclass(frozen=True)
class Column:
    """A column of a table, with cells of one kind."""

    key: str  # its name in CSV
    title: str
    kind: type[Cell] = Rate
    demos: int | None = None  # demonstrations that policies of this column have learnt from
    same_sample: bool = False  # same attempts as the column before it, which has the notes

    @property
    def compared(self) -> bool:
        """Whether the figures are of a kind that the paper has too."""
        return self.kind in (Rate, Length)


@dataclass(frozen=True)
class Line:
    """One row of a table: a name and a cell for each column."""

    key: str  # its name in CSV
    title: str
    cells: tuple[Cell, ...]
    average: bool = False  # whether it averages lines above it

    @property
    def measured(self) -> bool:
        """Whether any figure of ours is in it."""
        return not all(map(_is_empty, self.cells))


@dataclass(frozen=True)
class Table:
    """A table. `heading` is the title of the column of row titles."""

    name: str
    title: str
    caption: str
    heading: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()

    def cell(self, line: str, column: str) -> Cell:
        """The cell of a row and a column, by their keys. Raises ArgumentError naming what exists."""
        lines = {item.key: item for item in self.lines}
        columns = {item.key: index for index, item in enumerate(self.columns)}
        if line not in lines:
            raise unknown_choice(f"row of table {self.name}", line, lines)
        if column not in columns:
            raise unknown_choice(f"column of table {self.name}", column, columns)
        return lines[line].cells[columns[column]]

    @property
    def compared(self) -> list[tuple[int, int | None]]:
        """Indices of columns of figures that the paper has too, each with that of its violations, if any."""
        followed_by_violations = [*(column.same_sample for column in self.columns[1:]), False]
        return [
            (index, index + 1 if followed_by_violations[index] else None)
            for index, column in enumerate(self.columns)
            if column.compared
        ]

    @property
    def measured(self) -> bool:
        """Whether any figure of ours is in it."""
        return any(line.measured for line in self.lines)

    @property
    def without_empty(self) -> "Table":
        """The table without lines and columns that lack figures of ours, named in notes; itself if all do."""
        if not self.measured:
            return self
        lines = [line for line in self.lines if line.measured]
        indices = [
            index
            for index, column in enumerate(self.columns)
            if column.kind is Text or any(not _is_empty(line.cells[index]) for line in lines)
        ]
        columns = tuple(self.columns[index] for index in indices)
        unmeasured = [line.title for line in self.lines if not line.measured and not line.average]
        empty = [each.title for each in self.columns if each not in columns and not each.same_sample]
        added = (f"Not measured yet: {', '.join(titles)}." for titles in (unmeasured, empty) if titles)
        kept = tuple(replace(line, cells=tuple(line.cells[index] for index in indices)) for line in lines)
        return replace(self, columns=columns, lines=kept, notes=(*self.notes, *added))


def _is_empty(cell: Cell) -> bool:
    """Whether a cell holds no figure of ours."""
    return isinstance(cell, Text) or cell.missing


def text_columns(**titles: str) -> tuple[Column, ...]:
    """A column of texts for each title, by its key."""
    return tuple(Column(key, title, Text) for key, title in titles.items())


def with_violations(
    key: str, title: str, kind: type[Cell] = Rate, demos: int | None = None
) -> tuple[Column, Column]:
    """A column of figures, and one beside it with the violations of the same attempts."""
    violations = Column(f"{key}_violations", "violations", Violations, same_sample=True)
    return Column(key, title, kind, demos), violations
