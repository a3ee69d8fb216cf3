"""Pages from templates: what they say comes from the caller, how it is said from a file beside it."""

from pathlib import Path
from typing import Any

from rf_exp.texts import visible
from rf_exp.texts.markdown import Markdown, text


def rendered(template: Path, **values: object) -> str:
    """The page that a Jinja2 template makes of some values; in HTML and Markdown what they hold is escaped.

    Unless it is markup already: markupsafe's in HTML, `rf_exp.texts.markdown.Markdown` in Markdown (`.md`).
    The template may include others of its folder. A name in it that has no value is an error.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape  # only for pages

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        finalize=_words if template.suffix == ".md" else _letters,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template.name).render(values)


def _letters(value: Any) -> Any:
    """A value on a page, without characters that cannot be shown; whole, as a picture may be in it."""
    return visible(value, "\n") if type(value) is str else value  # what is markup has a type of its own


def _words(value: Any) -> Any:
    return text(value) if isinstance(value, str) and not isinstance(value, Markdown) else value
