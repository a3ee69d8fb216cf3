"""Texts of others, fit to be shown: of servers, models, stores, tasks, rows, files and the names of files.

A control character could clear a terminal, rename its window or end a line of a log, a mark of direction
make a name read otherwise than it is, and a text be as long as its sender likes. Whatever is printed,
logged, raised or put on a page passes here.
"""

MISSING = "\N{REPLACEMENT CHARACTER}"  # in the place of a character that cannot be shown
LONGEST_ERROR = 4_000  # characters
LONGEST_LINE = 4_000
LONGEST_OUTPUT = 200_000  # of what is printed at once, of a log, and of lines of code on a page


def visible(text: str, keep: str = "") -> str:
    """The text with one kind of space, and what has no shape replaced: controls, marks of direction."""
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() or letter in keep else " " if letter.isspace() else MISSING
        for letter in text
    )


def printable(text: object, longest: int = 300) -> str:
    """A text of somebody else on one line, without control characters, to be repeated in a message."""
    return visible(" ".join(str(text)[: 4 * longest].split()))[:longest]


def shown(text: str, longest: int = LONGEST_OUTPUT) -> str:
    """A text with its lines, each of them printable, and nothing that would make it longer than `longest`.

    What is too long lacks its middle: an error ends with what is to be done.
    """
    lines = visible(_cut(text, longest), keep="\n").split("\n")
    return "\n".join(_cut(line, LONGEST_LINE) for line in lines)


def one_line(text: str, longest: int = LONGEST_OUTPUT) -> str:
    """A text on one line, its spaces as they are."""
    return shown(text, longest).replace("\n", " ")


def _cut(text: str, longest: int) -> str:
    if len(text) <= longest:
        return text
    told = f" [... {len(text) - longest} characters left out ...] "
    tail = longest // 3
    return text[: longest - tail] + told + text[-tail:]
