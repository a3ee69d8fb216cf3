"""Texts of others in Markdown: words, code and blocks that no reader of Markdown takes for markup.

Titles, reasons and answers are put into pages that GitHub, MkDocs and data hubs make HTML of. Each of these
functions makes a `Markdown` of a text; templates of pages (`rf_exp.artifacts.rendered`) do so with every
value that is none yet.
"""

import re
from collections.abc import Iterable, Sequence

from .plain import printable, shown

LONGEST_TEXT = 4_000  # characters of one value on a page

# Character references mean the same to all readers; of backslashes they do not agree which are escapes.
_SAID = {"<": "&lt;", "|": "\\|"}
_MARKUP = re.compile(
    r"""(?P<anywhere>[\\`*~{@<|])
    | (?P<entity>&)(?=\#?\w+;)
    | (?P<emphasis>(?<![^\W_])_|_(?![^\W_]))  # within a word it is a part of it
    | (?P<link>\](?=\s*[(\[:])|\[(?=\^))
    | (?P<address>:(?=//)|(?<=\bwww)\.)  # GitHub makes links of bare ones
    """,
    re.VERBOSE | re.IGNORECASE,
)
# What begins a heading, a quotation, an item, an underline, an admonition.
_BEGINNING = re.compile(r"\A(?:[#>=]|[-+:!?](?=[\s!?-]|\Z)|\d+[.)](?=\s|\Z))")
# In a block: what could end its fence, and what would be markup to a reader that knows no fences.
_RISKY = re.compile(r"[<`~@]|//|\][(\[:]|^\s*$|^\s*(?:[#>*+=-]|\d+[.)])", re.MULTILINE)


class Markdown(str):
    """A text that is Markdown, and is put into a page as it is."""

    __slots__ = ()


def text(value: object) -> Markdown:
    """Words for a line of a paragraph, a heading or an item."""
    return Markdown(_BEGINNING.sub(_reference, cell(value)))


def cell(value: object) -> Markdown:
    """Words within a line, of a cell of a table for instance."""
    return Markdown(_MARKUP.sub(_reference, printable(value, LONGEST_TEXT)))


def code(value: object) -> Markdown:
    """Code within a line or a cell."""
    line = printable(value, LONGEST_TEXT)
    if not line:
        return Markdown("")
    return Markdown(f"<code>{cell(line)}</code>" if {"`", "|"} & {*line} else f"`{line}`")


def block(value: str, language: str = "") -> Markdown:
    """Lines of code: of a language in a fence, unless something in them could end it; else indented.

    Nothing can end that, and every reader of Markdown knows it. The comment ends a list, of whose last item
    it would be a part.
    """
    lines = shown(value).rstrip("\n")
    if not language or _RISKY.search(lines):
        return Markdown("<!-- -->\n\n" + "\n".join(f"    {line}" for line in lines.split("\n")))
    return Markdown(f"```{language}\n{lines}\n```")


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> Markdown:
    """A table whose cells are Markdown already."""
    every = (heading, ["---"] * len(heading), *rows)
    return Markdown("\n".join("| " + " | ".join(row) + " |" for row in every))


def _reference(found: re.Match[str]) -> str:
    """What is written in the place of a part that would be markup."""
    part = found[0]
    return _SAID.get(part, f"{part[:-1]}&#{ord(part[-1])};")
