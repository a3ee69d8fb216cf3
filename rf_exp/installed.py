"""Where the files lie that come with the code, in a checkout and where it is installed."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
CHECKED_OUT = (_PACKAGE.parent / "pyproject.toml").is_file()

# Of a checkout at its top, of an installation inside of the package: at the top of site-packages any other
# package may write to a folder of that name.
CONF = (_PACKAGE.parent if CHECKED_OUT else _PACKAGE) / "conf"
