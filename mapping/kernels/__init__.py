"""Hot loops: numba functions on plain arrays. Arrays that a kernel changes are said so ("in place") in its docstring.

Parallel kernels share nothing between iterations, so that any number of threads gives the same result.
"""

from __future__ import annotations

import os
from typing import Any

import numba
import numpy as np

if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    # TBB as distributions ship it is often too old for numba, which then warns at the first parallel call.
    _config: Any = numba.config
    _config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]
# Waiting threads sleep instead of spinning: on a busy machine spinning takes the core that the work waits for, and an
# image that costs 1 ms took 16. Read by the OpenMP library when it is loaded, at the first parallel call.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# Large arrays that are freed go back to the operating system, and each page of the next one is paid for again: 4 µs on
# a virtual machine, 1 ms a megabyte, more than most kernels take. glibc keeps arrays up to the size of the largest that
# it has seen freed (mallopt(3), M_MMAP_THRESHOLD; 32 MiB at most): so it is shown one. It is never touched: no memory.
np.empty(31 << 20, np.uint8)
