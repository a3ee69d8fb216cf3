"""Pages from Jinja2 templates: the caller gives the values, a template file the wording."""

from pathlib import Path
from typing import Any

from rf_exp.texts import visible
from rf_exp.texts.markdown import Markdown, text


def render_template(template: Path, **values: object) -> str:
    """Renders a Jinja2 template; values are escaped in HTML and Markdown.

    Values that are markup already are not: markupsafe's in HTML, `rf_exp.texts.markdown.Markdown` in Markdown
    (`.md`). The template may include others of its folder. An undefined name is an error.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape  # only for pages

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        finalize=_finalize_markdown if template.suffix == ".md" else _finalize_html,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template.name).render(values)


def _finalize_html(value: Any) -> Any:
    """A value without unprintable characters; never shortened, as it may contain a picture."""
    return visible(value, "\n") if type(value) is str else value  # markup has a type of its own


def _finalize_markdown(value: Any) -> Any:
    return text(value) if isinstance(value, str) and not isinstance(value, Markdown) else value
