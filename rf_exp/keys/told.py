"""The description of the keys in `--help`: defaults and comments of conf/config.yaml."""

import re
import shutil
import textwrap

from rf_exp.installed import CONF

KEY = re.compile(r"(?P<indent> *)(?P<key>\w+):(?P<default>(?: (?!#)[^#]*?)?)(?: +# (?P<meaning>.*))?")
SECTION = re.compile(r"# -- (?P<title>.*)")
MORE = re.compile(r" *# (?P<meaning>.*)")
WIDEST = 110  # characters of a line


def keys_told() -> str:
    """One line per key of the experiment, with its default, and its meaning below."""
    text = (CONF / "config.yaml").read_text("utf-8").partition("\n\n")[2].partition("\nhydra:")[0]
    lines: list[str] = []
    for line in text.splitlines():
        if found := SECTION.fullmatch(line):
            lines += ["", f"-- {found['title']}"]
        elif found := KEY.fullmatch(line):
            lines.append(f"{found['indent']}{found['key']}: {found['default'].strip()}".rstrip())
            lines += _meaning(found["indent"], found["meaning"] or "")
        elif found := MORE.fullmatch(line):
            lines += _meaning("", found["meaning"])
    return "\n".join(lines).replace("$", "$$")  # Hydra interpolates after a single one


def _meaning(indent: str, said: str) -> list[str]:
    width = min(WIDEST, shutil.get_terminal_size().columns)
    return textwrap.wrap(said, width, initial_indent=indent + " " * 8, subsequent_indent=indent + " " * 8)
