"""Untrusted words on Markdown pages: no reader turns them into tags, links or cells."""

from collections.abc import Callable

import pytest

from rf_exp.demonstration.page import webpage
from rf_exp.texts.markdown import block, cell, code, table, text
from tests.trust.payloads import EXTENSIONS, MARK, MARKUP, Skeleton, skeleton, structure

READERS = pytest.mark.parametrize("extensions", EXTENSIONS, ids=lambda each: "-".join(each[:2]) or "none")


def page_with(formatter: Callable[[str], str], payload: str) -> str:
    """A page with the payload in every place where our pages have words."""
    s = formatter(payload)
    rows = table(("a", cell(payload)), [(cell(payload), s), ("x", s), (cell(payload), "x")])
    return (
        f"# {s}\n\n{s}\n\nso: {s}, and {s}.\n\n- {s}\n- *b*: {s}\n\n1. {s}\n2. {s}\n\n"
        f"{rows}\n\n**{s}**: end\n"
    )


@READERS
@pytest.mark.parametrize("formatter", [text, code])
@pytest.mark.parametrize("payload", MARKUP)
def test_payloads_add_no_tags_to_a_page(
    payload: str, formatter: Callable[[str], str], extensions: list[str]
) -> None:
    tags, words = structure(page_with(formatter, payload), extensions)
    assert tags == structure(page_with(formatter, MARK), extensions)[0]
    assert words.count(MARK) >= 10


@pytest.mark.parametrize("formatter", [text, code])
@pytest.mark.parametrize("payload", MARKUP)
def test_payloads_add_no_tags_to_a_web_page(payload: str, formatter: Callable[[str], str]) -> None:
    hostile, plain = Skeleton(), Skeleton()
    for parsed, content in ((hostile, payload), (plain, MARK)):
        parsed.feed(webpage(page_with(formatter, content)))
        parsed.close()
    assert hostile.tags == plain.tags and hostile.words.count(MARK) >= 10


@READERS
@pytest.mark.parametrize("language", ["", "python"])
@pytest.mark.parametrize("payload", MARKUP)
def test_a_code_block_holds_its_lines_and_ends_after_them(
    payload: str, language: str, extensions: list[str]
) -> None:
    page = f"before\n\n- an item\n\n{block(payload, language)}\n\n*behind*\n"
    tags, words = structure(page, extensions)
    assert {tag.lstrip("/") for tag, _ in tags} <= {
        "p",
        "pre",
        "code",
        "em",
        "div",
        "span",
        "ul",
        "li",
        "!--",
    }
    assert all(key == "class" for _, attributes in tags for key, _ in attributes)
    assert ("pre", ()) not in tags[: tags.index(("/ul", ()))]  # not a part of the item
    assert tags[-4:] == [("p", ()), ("em", ()), ("/em", ()), ("/p", ())]
    for line in payload.split("\n"):
        cleaned = line.encode("utf-8", "replace").decode().strip("\x02\x03 ?")
        assert cleaned.strip() in words or "\x02" in line


@pytest.mark.parametrize(
    "content",
    [
        "Agent_1 must lift barrier at left, by 0.15 m (97.5 %, [93.1, 99.1]); R&D: 2 > 1 + 1 - 0.",
        "lift_barrier, fast+dagger1, 50",
        "-0.004 m",
        "0.1 m off",
        "VSO(Agent_1, objects) = 3 / 4",
        "steak inside the pot; agents 1 and 2 touched (2.30 s, 14 steps)",
    ],
)
def test_text_without_markup_is_unchanged(content: str) -> None:
    assert (
        text(content) == content and code(content) == f"`{content}`" and content in block(content, "python")
    )


@READERS
def test_every_character_of_a_text_is_shown(extensions: list[str]) -> None:
    content = "".join(map(chr, range(33, 127))) + " ä € 日本 " + "".join(map(chr, range(126, 32, -1)))
    assert content in skeleton(f"x {text(content)} y", [*extensions, "tables"]).words
    assert content in skeleton(f"x {code(content)} y", [*extensions, "tables"]).words


def test_long_texts_are_shortened() -> None:
    assert len(text("x" * 10**7)) < 10_000 and len(code("y" * 10**7)) < 10_000
    assert len(block("z\n" * 10**7)) < 6_000_000
