"""What all commands of the suite have in common: where their configuration is, and how they end."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from rf_exp.errors import ArgumentError, RfError
from rf_exp.secrets import refuse_keys

CONF = Path(__file__).resolve().parents[1] / "conf"


def register_all_tasks() -> None:
    """Makes `task=all` mean every file in conf/task, so that a new task edits no list."""
    names = sorted(path.stem for path in (CONF / "task").glob("*.yaml"))
    ConfigStore.instance().store(group="task", name="all", node={"defaults": names})


def guarded(job: Callable[[], None]) -> int:
    """Runs `job`; its exit code. 0 done, 1 a stage failed, 2 a wrong argument, 130 interrupted."""
    # Hydra would print every error itself and exit with 1; this lets them through to here.
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    try:
        refuse_keys(sys.argv[1:])  # before Hydra writes them to a file
        job()
    except (ArgumentError, HydraException, OmegaConfBaseException) as error:
        print(f"wrong argument: {error}", file=sys.stderr)
        return 2
    except RfError as error:
        print(f"failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return 0
