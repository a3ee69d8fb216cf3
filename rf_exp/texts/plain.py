"""Sanitising of untrusted text: from servers, models, stores, tasks, rows, files and file names.

Control characters could clear a terminal, rename its window or end a line of a log, direction marks can
disguise a name, and a text may have any length. Everything that is printed, logged, raised or put on a page
passes through here.
"""

MISSING = "\N{REPLACEMENT CHARACTER}"  # replaces a character that cannot be shown
LONGEST_ERROR = 4_000  # characters
LONGEST_LINE = 4_000
LONGEST_OUTPUT = 200_000  # of one printed text, of a log, of a code block on a page


def visible(text: str, keep: str = "") -> str:
    """The text with one kind of space; unprintable characters (controls, direction marks) are replaced."""
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() or letter in keep else " " if letter.isspace() else MISSING
        for letter in text
    )


def printable(text: object, longest: int = 300) -> str:
    """An untrusted text on one line, without control characters, for quoting in a message."""
    return visible(" ".join(str(text)[: 4 * longest].split()))[:longest]


def shown(text: str, longest: int = LONGEST_OUTPUT) -> str:
    """A text with its lines, all printable, cut to about `longest` characters.

    Long texts lose their middle: an error ends with what is to be done.
    """
    lines = visible(_shorten(text, longest), keep="\n").split("\n")
    return "\n".join(_shorten(line, LONGEST_LINE) for line in lines)


def one_line(text: str, longest: int = LONGEST_OUTPUT) -> str:
    """A text on one line, with its spaces kept."""
    return shown(text, longest).replace("\n", " ")


def _shorten(text: str, longest: int) -> str:
    if len(text) <= longest:
        return text
    omission = f" [... {len(text) - longest} characters left out ...] "
    tail = longest // 3
    return text[: longest - tail] + omission + text[-tail:]
