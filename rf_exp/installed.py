"""Location of the files that come with the code, in a checkout and in an installation."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
CHECKED_OUT = (_PACKAGE.parent / "pyproject.toml").is_file()

# At the top of a checkout; inside the package where it is installed, because any other package may write to
# a folder of that name at the top of site-packages.
CONF = (_PACKAGE.parent if CHECKED_OUT else _PACKAGE) / "conf"
