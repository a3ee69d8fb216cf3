"""Texts of others, fit to be shown: `plain` ones, and in `markdown`."""

from rf_exp.texts import markdown
from rf_exp.texts.plain import (
    LONGEST_ERROR,
    LONGEST_LINE,
    LONGEST_OUTPUT,
    MISSING,
    one_line,
    printable,
    shown,
    visible,
)

__all__ = [
    "LONGEST_ERROR",
    "LONGEST_LINE",
    "LONGEST_OUTPUT",
    "MISSING",
    "markdown",
    "one_line",
    "printable",
    "shown",
    "visible",
]
