"""Pages from templates: what they say comes from the caller, how it is said from a file beside it."""

from pathlib import Path


def rendered(template: Path, **values: object) -> str:
    """The page that a Jinja2 template makes of some values; in HTML whatever they hold is escaped.

    The template may include others of its folder. A name in it that has no value is an error.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape  # only for pages

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template.name).render(values)
