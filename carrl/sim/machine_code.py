"""How the simulator's inner loops become machine code for the CPU.

Numba compiles a function when it is first called, in a few seconds, and keeps the code in `__pycache__` beside its
file. Where that cannot be written it uses the user's cache folder; NUMBA_CACHE_DIR names another one. Where none can be
written, every process compiles anew. The cache sees only changes to a function's own file, so what a compiled function
takes from elsewhere must be among its arguments.
"""

from collections.abc import Callable
from typing import Any

import numba

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""A division by zero gives inf or nan, as in torch."""
inlined = numba.njit(inline="always", **_OPTIONS)
"""Without being told so Numba passes all of a large tuple at each call, which takes longer than most functions do."""


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function for calls from Python, or takes it from the cache."""
    try:
        return numba.njit(function, cache=True, **_OPTIONS)
    except RuntimeError:  # There is no folder that the cache can be written to.
        return numba.njit(function, **_OPTIONS)
