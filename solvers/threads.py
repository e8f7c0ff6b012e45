"""Single-threaded linear algebra in the bundled solvers.

CasADi's wheel bundles a generic build of OpenBLAS, which is slower on two threads than on one for
the small dense blocks of a sparse factorisation. The library reads its environment variables only
when it is loaded, so the number of threads is set through its API. Environment variables set by
the user take precedence.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path

__all__ = ["THREAD_VARIABLES", "use_one_blas_thread"]

THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "GOTO_NUM_THREADS")


@cache
def use_one_blas_thread() -> bool:
    """Set CasADi's bundled OpenBLAS to one thread, unless the environment sets the number of threads.

    Returns
    -------
    bool
        Whether a library was found and set.
    """
    if any(name in os.environ for name in THREAD_VARIABLES):
        return False
    import casadi

    found = False
    for path in sorted(Path(casadi.__file__).parent.glob("*openblas*")):
        try:
            library = ctypes.CDLL(str(path))
            library.openblas_set_num_threads(1)
        except (OSError, AttributeError):
            continue  # not a loadable library, or one without this function
        found = True
    return found
