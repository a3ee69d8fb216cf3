"""RoboFactory experiments: several arms at one table, compositional constraints.

Importing the package selects the kernels of NumPy and OpenBLAS (`KERNELS`) for this process and its children,
unless NumPy was imported before or the environment variables are set already.
"""

import os
from contextlib import suppress
from pathlib import Path

# Every x86-64 processor with AVX2 can run them. For NumPy: "CPU build options" of its documentation.
KERNELS = {"OPENBLAS_CORETYPE": "Haswell", "NPY_ENABLE_CPU_FEATURES": "X86_V3"}


def _choose_kernels() -> None:
    """Sets `KERNELS` in the environment, as by default both libraries choose by the type of processor.

    Results would then differ in the last bit, so collisions, and with them whole episodes, would depend on
    the machine.
    """
    # NumPy accepts only one of these two variables.
    chosen = {"NPY_ENABLE_CPU_FEATURES"} if "NPY_DISABLE_CPU_FEATURES" in os.environ else set()
    with suppress(OSError), Path("/proc/cpuinfo").open() as processors:  # exists only on Linux
        # The first processor stands for all: reading about each takes long on a large machine.
        if "avx2" in next((line for line in processors if line.startswith("flags")), "").split():
            for name in KERNELS.keys() - chosen:
                os.environ.setdefault(name, KERNELS[name])


_choose_kernels()
