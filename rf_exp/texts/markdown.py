"""Escaping of untrusted text for Markdown: words, code and blocks that no Markdown reader takes for markup.

Titles, reasons and answers are put into pages that GitHub, MkDocs and data hubs convert to HTML. Each of
these functions makes a `Markdown` of a text; page templates (`rf_exp.artifacts.render_template`) do so with
every value that is not one yet.
"""

import re
from collections.abc import Iterable, Sequence

from .plain import printable, shown

LONGEST_TEXT = 4_000  # characters of one value on a page

# Readers agree on character references, but not on which backslashes are escapes.
_ESCAPES = {"<": "&lt;", "|": "\\|"}
_MARKUP = re.compile(
    r"""(?P<anywhere>[\\`*~{@<|])
    | (?P<entity>&)(?=\#?\w+;)
    | (?P<emphasis>(?<![^\W_])_|_(?![^\W_]))  # within a word it is a part of it
    | (?P<link>\](?=\s*[(\[:])|\[(?=\^))
    | (?P<address>:(?=//)|(?<=\bwww)\.)  # GitHub makes links of bare ones
    """,
    re.VERBOSE | re.IGNORECASE,
)
# Beginnings of a heading, a quotation, a list item, an underline, an admonition.
_LINE_START = re.compile(r"\A(?:[#>=]|[-+:!?](?=[\s!?-]|\Z)|\d+[.)](?=\s|\Z))")
# In a block: text that could end its fence, or is markup to a reader without support for fences.
_UNFENCEABLE = re.compile(r"[<`~@]|//|\][(\[:]|^\s*$|^\s*(?:[#>*+=-]|\d+[.)])", re.MULTILINE)


class Markdown(str):
    """Markdown text, which is put into a page unescaped."""

    __slots__ = ()


def text(value: object) -> Markdown:
    """Escaped words for a line of a paragraph, a heading or a list item."""
    return Markdown(_LINE_START.sub(_escape, cell(value)))


def cell(value: object) -> Markdown:
    """Escaped words within a line, for instance in a table cell."""
    return Markdown(_MARKUP.sub(_escape, printable(value, LONGEST_TEXT)))


def code(value: object) -> Markdown:
    """Code within a line or a table cell."""
    line = printable(value, LONGEST_TEXT)
    if not line:
        return Markdown("")
    return Markdown(f"<code>{cell(line)}</code>" if {"`", "|"} & {*line} else f"`{line}`")


def block(value: str, language: str = "") -> Markdown:
    """A code block: fenced, with its language, unless its lines could end the fence; else indented.

    Nothing can end an indented block, and every Markdown reader supports it. The comment ends a preceding
    list, which would otherwise absorb the block.
    """
    lines = shown(value).rstrip("\n")
    if not language or _UNFENCEABLE.search(lines):
        return Markdown("<!-- -->\n\n" + "\n".join(f"    {line}" for line in lines.split("\n")))
    return Markdown(f"```{language}\n{lines}\n```")


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> Markdown:
    """A table whose cells are Markdown already."""
    lines = (heading, ["---"] * len(heading), *rows)
    return Markdown("\n".join("| " + " | ".join(row) + " |" for row in lines))


def _escape(match: re.Match[str]) -> str:
    """Replacement for a part that would be markup."""
    part = match[0]
    return _ESCAPES.get(part, f"{part[:-1]}&#{ord(part[-1])};")
