"""Words of others on pages in Markdown: no reader makes a tag, a link or a cell of them."""

from collections.abc import Callable

import pytest

from rf_exp.demonstration.page import webpage
from rf_exp.texts.markdown import block, cell, code, table, text
from tests.trust.payloads import EXTENSIONS, MARK, MARKUP, Skeleton, skeleton, structure

READERS = pytest.mark.parametrize("extensions", EXTENSIONS, ids=lambda each: "-".join(each[:2]) or "none")


def lines(word: Callable[[str], str], payload: str) -> str:
    """A page that has the words in every place that a word has on ours."""
    it = word(payload)
    grid = table(("a", cell(payload)), [(cell(payload), it), ("x", it), (cell(payload), "x")])
    return (
        f"# {it}\n\n{it}\n\nso: {it}, and {it}.\n\n- {it}\n- *b*: {it}\n\n1. {it}\n2. {it}\n\n"
        f"{grid}\n\n**{it}**: end\n"
    )


@READERS
@pytest.mark.parametrize("word", [text, code])
@pytest.mark.parametrize("payload", MARKUP)
def test_words_change_nothing_of_a_page_but_its_words(
    payload: str, word: Callable[[str], str], extensions: list[str]
) -> None:
    tags, words = structure(lines(word, payload), extensions)
    assert tags == structure(lines(word, MARK), extensions)[0]
    assert words.count(MARK) >= 10


@pytest.mark.parametrize("word", [text, code])
@pytest.mark.parametrize("payload", MARKUP)
def test_a_web_page_has_no_tag_of_theirs(payload: str, word: Callable[[str], str]) -> None:
    found, plain = Skeleton(), Skeleton()
    for parsed, said in ((found, payload), (plain, MARK)):
        parsed.feed(webpage(lines(word, said)))
        parsed.close()
    assert found.tags == plain.tags and found.words.count(MARK) >= 10


@READERS
@pytest.mark.parametrize("language", ["", "python"])
@pytest.mark.parametrize("payload", MARKUP)
def test_a_block_holds_lines_and_ends_behind_them(payload: str, language: str, extensions: list[str]) -> None:
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
    assert all(kind == "class" for _, kinds in tags for kind, _ in kinds)
    assert ("pre", ()) not in tags[: tags.index(("/ul", ()))]  # it is no part of the item
    assert tags[-4:] == [("p", ()), ("em", ()), ("/em", ()), ("/p", ())]
    for line in payload.split("\n"):
        kept = line.encode("utf-8", "replace").decode().strip("\x02\x03 ?")
        assert kept.strip() in words or "\x02" in line


@pytest.mark.parametrize(
    "said",
    [
        "Agent_1 must lift barrier at left, by 0.15 m (97.5 %, [93.1, 99.1]); R&D: 2 > 1 + 1 - 0.",
        "lift_barrier, fast+dagger1, 50",
        "-0.004 m",
        "0.1 m off",
        "VSO(Agent_1, objects) = 3 / 4",
        "steak inside the pot; agents 1 and 2 touched (2.30 s, 14 steps)",
    ],
)
def test_what_is_no_markup_is_written_as_it_is(said: str) -> None:
    assert text(said) == said and code(said) == f"`{said}`" and said in block(said, "python")


@READERS
def test_every_letter_of_a_text_is_shown(extensions: list[str]) -> None:
    said = "".join(map(chr, range(33, 127))) + " ä € 日本 " + "".join(map(chr, range(126, 32, -1)))
    assert said in skeleton(f"x {text(said)} y", [*extensions, "tables"]).words
    assert said in skeleton(f"x {code(said)} y", [*extensions, "tables"]).words


def test_of_a_long_text_a_page_has_a_part() -> None:
    assert len(text("x" * 10**7)) < 10_000 and len(code("y" * 10**7)) < 10_000
    assert len(block("z\n" * 10**7)) < 6_000_000
