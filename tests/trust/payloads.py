"""Hostile texts: markup and terminal control sequences where a word is expected."""

from html.parser import HTMLParser

import markdown

MARK = "intruder"  # in every payload, to search for it
MARKUP = (
    f"<script>{MARK}()</script>",
    f"<img src=x onerror={MARK}()>",
    f"<svg/onload={MARK}()>",
    f"</code></pre></td></table></details><script>{MARK}()</script>",
    f"<!-- {MARK} --><b>{MARK}</b>",
    f"&lt;b&gt;{MARK}&lt;/b&gt; &#60;i&#62;",
    f"[{MARK}](javascript:{MARK}())",
    f"![{MARK}](https://example.org/{MARK}.png)",
    f"[{MARK}][1]\n\n[1]: javascript:{MARK}()",
    f"<https://example.org/{MARK}> https://example.org/{MARK} www.example.org",
    f"{MARK}@example.org <mailto:{MARK}@example.org>",
    f"```\n<script>{MARK}()</script>\n```",
    f"~~~\n<script>{MARK}()</script>\n~~~",
    f"````\n```\n<b>{MARK}</b>",
    f"\n\n<div onclick={MARK}()>\n\n",
    f"` <b>{MARK}</b> `` <i>{MARK}</i> `",
    f"`{MARK}",
    f"a | b | {MARK} |\n| --- | --- |",
    f"\\| {MARK} \\\\| x \\",
    f"**{MARK}** __{MARK}__ *a* _b_ ~~c~~",
    f"# {MARK}",
    f"\n# {MARK}\n\n> {MARK}\n\n- {MARK}\n\n1. {MARK}\n\n---\n",
    f"1. {MARK}",
    f"- {MARK}",
    f"{MARK}\n===",
    f"{MARK} {{: onclick={MARK}() .{MARK} }}",
    f"!!! note {MARK}",
    f"[^{MARK}]: x [^{MARK}]",
    f"*[{MARK}]: x",
    f"{MARK}\n: definition",
    f"\x02wzxhzdk:0\x03 {MARK}",
    f"{MARK} {{{{ 7 * 7 }}}} {{% raw %}}",
    f"\ud800{MARK}\udfff",
)
CONTROLS = (  # terminal controls: title, colours, screen, bell, new line, text direction
    f"\x1b]0;{MARK}\x07\x1b[2J\x1b[31m\x9b31m\x9d0;{MARK}\x9c\x08\x7f\u202e{MARK}\u2066\u200f\ud800"
    f"\r\nfailed: {MARK}\x85\u2028\x00"
)
EXTENSIONS = (  # of Markdown readers: none, MkDocs's own, common ones, and those of this site
    [],
    ["tables", "fenced_code", "toc"],
    ["extra", "attr_list", "md_in_html", "admonition", "def_list", "footnotes", "abbr"],
    ["tables", "attr_list", "admonition", "pymdownx.superfences", "pymdownx.highlight", "pymdownx.magiclink"],
)


class Skeleton(HTMLParser):
    """The tags of a page with their attributes, and its words separately."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, tuple]] = []
        self.words = ""

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, tuple(attrs)))

    def handle_endtag(self, tag: str) -> None:
        self.tags.append((f"/{tag}", ()))

    def handle_comment(self, data: str) -> None:
        self.tags.append(("!--", ()))

    def handle_data(self, data: str) -> None:
        self.words += data


def skeleton(page: str, extensions: list[str]) -> Skeleton:
    """The skeleton of the HTML that a Markdown reader with these extensions makes of a page."""
    parsed = Skeleton()
    parsed.feed(markdown.markdown(page, extensions=extensions))
    parsed.close()
    return parsed


def structure(page: str, extensions: list[str]) -> tuple[list[tuple[str, tuple]], str]:
    """The tags without ids of headings, and the words."""
    parsed = skeleton(page, extensions)
    tags = [
        (tag, tuple(attribute for attribute in attributes if attribute[0] != "id"))
        for tag, attributes in parsed.tags
    ]
    return tags, parsed.words
