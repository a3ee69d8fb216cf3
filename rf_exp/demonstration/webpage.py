"""A page of Markdown as HTML, whose parts can be reached from the top."""

from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt

from rf_exp.artifacts import rendered

TEMPLATE = Path(__file__).with_name("templates") / "page.html"
READER = MarkdownIt("commonmark").enable("table")


def webpage(page: str) -> str:
    """The page with its pictures beside it. What others say on it is escaped before it comes here."""
    tokens = READER.parse(page)
    title, parts = "", []
    for heading, words in pairwise(tokens):
        said = "".join(each.content for each in words.children or ())
        if heading.type == "heading_open" and heading.tag == "h1":
            title = said
        elif heading.type == "heading_open" and heading.tag == "h2":
            parts.append((anchor := f"part-{len(parts) + 1}", said))
            heading.attrSet("id", anchor)
    body = READER.renderer.render(tokens, READER.options, {})
    return rendered(TEMPLATE, title=title, parts=parts, body=body)
