"""RoboFactory experiments: several arms, one table, compositional constraints.

Importing it names the kernels with which NumPy and OpenBLAS compute (`KERNELS`), for this process and those
it starts, unless NumPy is there before it or its variables are set.
"""

import os
from contextlib import suppress
from pathlib import Path

# Those that every x86-64 processor with AVX2 can run. Of NumPy: "CPU build options" of its documentation.
KERNELS = {"OPENBLAS_CORETYPE": "Haswell", "NPY_ENABLE_CPU_FEATURES": "X86_V3"}


def _choose_kernels() -> None:
    """Left to themselves both take others on each kind of processor, and results differ in the last bit.

    What collides, and with it whole episodes, would then depend on the machine that made them.
    """
    chosen = {"NPY_ENABLE_CPU_FEATURES"} if "NPY_DISABLE_CPU_FEATURES" in os.environ else set()  # not both
    with suppress(OSError), Path("/proc/cpuinfo").open() as processors:  # there is none but on Linux
        # The first of them speaks for all: asking a large machine for each takes long.
        if "avx2" in next((line for line in processors if line.startswith("flags")), "").split():
            for name in KERNELS.keys() - chosen:
                os.environ.setdefault(name, KERNELS[name])


_choose_kernels()
