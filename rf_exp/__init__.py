"""RoboFactory experiments: several arms, one table, compositional constraints.

Importing it names the kernels with which OpenBLAS multiplies matrices, for this process and those it starts,
unless NumPy is there before it or `OPENBLAS_CORETYPE` is set.
"""

import os
from contextlib import suppress
from pathlib import Path

KERNELS = "Haswell"  # which every x86-64 processor with AVX2 can run


def _choose_kernels() -> None:
    """Left to itself OpenBLAS takes others on each kind of processor, and its sums differ in the last bit.

    What collides, and with it whole episodes, would then depend on the machine that made them.
    """
    with suppress(OSError), Path("/proc/cpuinfo").open() as processors:  # there is none but on Linux
        # The first of them speaks for all: asking a large machine for each takes long.
        if "avx2" in next((line for line in processors if line.startswith("flags")), "").split():
            os.environ.setdefault("OPENBLAS_CORETYPE", KERNELS)


_choose_kernels()
