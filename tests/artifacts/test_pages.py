"""Pages from templates: escaped in HTML, as they are in Markdown, and complete."""

from pathlib import Path

import pytest
from jinja2 import UndefinedError

from rf_exp.artifacts import rendered


@pytest.mark.parametrize(("suffix", "said"), [("html", "<p>&lt;b&gt; &amp;</p>\n"), ("md", "<p><b> &</p>\n")])
def test_what_values_hold_is_escaped_in_html(tmp_path: Path, suffix: str, said: str) -> None:
    template = tmp_path / f"page.{suffix}"
    template.write_text("<p>{{ text }}</p>\n")
    assert rendered(template, text="<b> &") == said


def test_a_template_includes_others_beside_it(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text('{% include "style.css" %}')
    (tmp_path / "style.css").write_text("b { color: red }\n")
    assert rendered(tmp_path / "page.html") == "b { color: red }\n"


def test_a_name_without_a_value_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("{{ missing }}")
    with pytest.raises(UndefinedError, match="'missing' is undefined"):
        rendered(tmp_path / "page.html")
