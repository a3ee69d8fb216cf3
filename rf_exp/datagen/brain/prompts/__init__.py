"""The texts that a language model reads. Placeholders are those of `string.Template`."""

from collections.abc import Iterable
from importlib.resources import files
from string import Template


def filled(name: str, **parts: str) -> str:
    """The text of `<name>.txt` with its placeholders filled in."""
    return Template(files(__name__).joinpath(f"{name}.txt").read_text(encoding="utf-8")).substitute(parts)


def listed(lines: Iterable[str]) -> str:
    """One line each, with a dash; `none` where there are none."""
    return "\n".join(f"- {line}" for line in lines) or "none"
