"""Extension of griffe, which parses the sources for mkdocs (mkdocs.yml): comments of fields as docstrings.

These comments hold shapes, units and frames.
"""

import re
from typing import Any

from griffe import Attribute, Docstring, Extension

COMMENT = re.compile(r"#\s*(?!pyright|noqa|fmt|type:)(.+?)\s*$")


class Fields(Extension):
    """Gives a field without a docstring the comment behind it and the comment lines below it."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        if attr.docstring is not None or attr.endlineno is None or attr.parent is None:
            return
        lines = attr.lines_collection[attr.filepath]  # pyright: ignore[reportArgumentType]
        code, _, _ = lines[attr.endlineno - 1].partition("  # ")
        trailing = COMMENT.search(lines[attr.endlineno - 1][len(code) :])
        comments = [trailing[1]] if trailing else []
        for line in lines[attr.endlineno :]:
            if not (continuation := COMMENT.fullmatch(line.strip())) or not attr.parent.is_class:
                break
            comments.append(continuation[1])
        if comments:
            attr.docstring = Docstring(" ".join(comments), parent=attr)
