"""What all commands of the suite have in common: how they end."""

import os
import sys
from collections.abc import Callable

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from rf_exp.datagen.brain.secrets import refuse_keys
from rf_exp.errors import ArgumentError, RfError


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
