"""The description of the keys in `--help`: defaults and comments of conf/config.yaml."""

import re
import shutil
import textwrap

from rf_exp.installed import CONF

KEY = re.compile(r"(?P<indent> *)(?P<key>\w+):(?P<default>(?: (?!#)[^#]*?)?)(?: +# (?P<meaning>.*))?")
SECTION = re.compile(r"# -- (?P<title>.*)")
CONTINUATION = re.compile(r" *# (?P<meaning>.*)")
MAX_WIDTH = 110  # characters of a line


def keys_help() -> str:
    """One line per key of the experiment, with its default, and its meaning below."""
    text = (CONF / "config.yaml").read_text("utf-8").partition("\n\n")[2].partition("\nhydra:")[0]
    lines: list[str] = []
    for line in text.splitlines():
        if match := SECTION.fullmatch(line):
            lines += ["", f"-- {match['title']}"]
        elif match := KEY.fullmatch(line):
            lines.append(f"{match['indent']}{match['key']}: {match['default'].strip()}".rstrip())
            lines += _meaning(match["indent"], match["meaning"] or "")
        elif match := CONTINUATION.fullmatch(line):
            lines += _meaning("", match["meaning"])
    return "\n".join(lines).replace("$", "$$")  # Hydra interpolates after a single one


def _meaning(indent: str, meaning: str) -> list[str]:
    width = min(MAX_WIDTH, shutil.get_terminal_size().columns)
    return textwrap.wrap(meaning, width, initial_indent=indent + " " * 8, subsequent_indent=indent + " " * 8)
