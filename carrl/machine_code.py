"""How inner loops become machine code for the CPU.

Numba compiles a function when it is first called, in a few seconds, and keeps the code in `__pycache__` beside its
file. Where that cannot be written it uses the user's cache folder; NUMBA_CACHE_DIR names another one. Where none can be
written, every process compiles anew. The cache sees only changes to a function's own file, so what a compiled function
takes from elsewhere must be among its arguments.
"""

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any

import numpy as np
import torch
from torch import Tensor

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""A division by zero gives inf or nan, as in torch."""


class compiled:  # noqa: N801 (a decorator)
    """Compiles a function for calls from Python, or takes it from the cache, when it is first called.

    Until then Numba is not imported, which takes half a second.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        update_wrapper(self, function)

    @cached_property
    def dispatcher(self) -> Any:
        """What Numba makes of it."""
        import numba

        try:
            return numba.njit(self._function, cache=True, **_OPTIONS)
        except RuntimeError:  # There is no folder that the cache can be written to.
            return numba.njit(self._function, **_OPTIONS)

    def __call__(self, *arguments: Any) -> Any:
        """Calls it."""
        return self.dispatcher(*arguments)


def dispatched(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, compiled or not, without what the decorator adds to each call."""
    return function.dispatcher if isinstance(function, compiled) else function


def inlined(function: Callable[..., Any]) -> Any:
    """Makes a function part of those compiled ones that call it.

    Without being told so Numba passes all of a large tuple at each call, which takes longer than most functions do.
    """
    import numba

    return numba.njit(function, inline="always", **_OPTIONS)


def apart(function: Callable[..., Any]) -> Any:
    """Lets compiled functions call this one, which is rare, so that their own loops stay short and fast."""
    import numba

    return numba.njit(function, inline="never", **_OPTIONS)


def reordering(function: Callable[..., Any]) -> Any:
    """As `apart`, for sums whose order does not matter: the processor adds as many numbers at once as it can.

    Their last digits depend on the processor, and on nothing else.
    """
    import numba

    return numba.njit(function, inline="never", fastmath={"reassoc", "contract", "nsz"}, **_OPTIONS)


def as_array(tensor: Tensor, dtype: torch.dtype) -> np.ndarray:
    """The tensor's own memory; a copy of one of another type or layout, for which Numba would compile anew."""
    return (tensor if tensor.dtype is dtype else tensor.to(dtype)).contiguous().numpy()
