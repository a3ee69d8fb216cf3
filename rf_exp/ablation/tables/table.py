"""A table: columns of one kind of cell each, and lines of cells."""

from dataclasses import dataclass

from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables.cells import Cell, Length, Rate, Text, Violations
from rf_exp.errors import choices


@dataclass(frozen=True)
class Column:
    """What is below one title, all of one kind."""

    key: str  # its name in CSV
    title: str
    kind: type[Cell] = Rate
    demos: int | None = None  # demonstrations that policies of this column have learnt from
    beside: bool = False  # of the attempts of the column before it: what is said once is said there

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
    average: bool = False  # of lines above it


@dataclass(frozen=True)
class Table:
    """A table of the paper. `heading` is the title of the column of row titles."""

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
            raise choices(f"row of table {self.name}", line, lines)
        if column not in columns:
            raise choices(f"column of table {self.name}", column, columns)
        return lines[line].cells[columns[column]]

    @property
    def compared(self) -> list[tuple[int, int | None]]:
        """The columns of figures that the paper has too, each with that of its violations, if it has one."""
        after = [*(column.beside for column in self.columns[1:]), False]
        return [
            (index, index + 1 if after[index] else None)
            for index, column in enumerate(self.columns)
            if column.compared
        ]

    @property
    def measured(self) -> bool:
        """Whether any figure of ours is in it."""
        return any(
            not isinstance(cell, Text) and not cell.missing for line in self.lines for cell in line.cells
        )


def with_violations(
    key: str, title: str, kind: type[Cell] = Rate, demos: int | None = None
) -> tuple[Column, Column]:
    """A column of figures and the one beside it, of the violations of the same attempts."""
    beside = Column(f"{key}_violations", "violations", Violations, beside=True)
    return Column(key, title, kind, demos), beside


def title_of(task: str, suite: Suite) -> str:
    """The configured title of a task; where it is not in the suite its name in title case."""
    known = suite.get(task)
    return known.title if known else task.replace("_", " ").title()
