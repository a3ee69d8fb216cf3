"""Which code made an artifact."""

import os
import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]


@cache
def commit(checkout: Path = CHECKOUT) -> str:
    """The git commit of the code that runs, with a + where files were changed since.

    Empty where the code is no checkout, or git does not answer.
    """
    if not (checkout / ".git").exists():  # installed; a repository further up is somebody else's
        return ""
    command = ["git", "--no-optional-locks", "-C", str(checkout), "describe"]
    command += ["--always", "--exclude=*", "--abbrev=12", "--dirty=+"]
    # Within a hook of git these variables would name another repository.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return ""
    return ran.stdout.strip()


def code(checkout: Path = CHECKOUT) -> str:
    """Which code runs, as every artifact says: its commit or, where it is no checkout, its version."""
    return commit(checkout) or f"rf_exp {installed(['rf_exp']).get('rf_exp', 'of unknown version')}"


def installed(packages: Iterable[str]) -> dict[str, str]:
    """The version of Python and of those packages that are installed."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue  # not every machine has the simulator
    return found
