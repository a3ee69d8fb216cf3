"""Pages from templates: values are escaped in HTML and Markdown unless they are markup, and complete."""

from pathlib import Path

import pytest
from jinja2 import UndefinedError

from rf_exp.artifacts import render_template
from rf_exp.texts.markdown import Markdown


@pytest.mark.parametrize(
    ("suffix", "expected"), [("html", "<p>&lt;b&gt; &amp;</p>\n"), ("md", "<p>&lt;b> &</p>\n")]
)
def test_values_are_escaped_in_html_and_markdown(tmp_path: Path, suffix: str, expected: str) -> None:
    template = tmp_path / f"page.{suffix}"
    template.write_text("<p>{{ text }}</p>\n")
    assert render_template(template, text="<b> &") == expected


def test_markdown_values_are_not_escaped(tmp_path: Path) -> None:
    template = tmp_path / "page.md"
    template.write_text("{{ made }} {{ said }} {{ 3 }}")
    assert (
        render_template(template, made=Markdown("*a* `b`"), said="*a* `b`")
        == "*a* `b` &#42;a&#42; &#96;b&#96; 3"
    )


def test_a_picture_in_a_page_is_complete(tmp_path: Path) -> None:
    template = tmp_path / "page.html"
    template.write_text('<img src="{{ picture }}">')
    picture = f"data:image/jpeg;base64,{'abcd' * 10**6}"
    assert render_template(template, picture=picture) == f'<img src="{picture}">'


@pytest.mark.parametrize("suffix", ["html", "md"])
def test_unprintable_characters_are_replaced(tmp_path: Path, suffix: str) -> None:
    template = tmp_path / f"page.{suffix}"
    template.write_text("{{ text }}")
    assert (
        render_template(template, text="a\x1b[2J\u202eb\x9b\ud800").encode("utf-8").decode()
        == "a\ufffd[2J\ufffdb" + "\ufffd" * 2
    )


def test_a_template_may_include_files_beside_it(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text('{% include "style.css" %}')
    (tmp_path / "style.css").write_text("b { color: red }\n")
    assert render_template(tmp_path / "page.html") == "b { color: red }\n"


def test_a_name_without_a_value_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("{{ missing }}")
    with pytest.raises(UndefinedError, match="'missing' is undefined"):
        render_template(tmp_path / "page.html")
