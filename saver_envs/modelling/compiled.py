"""Functions that Numba compiles: loops over arms and joints that are slow in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Return a function as machine code, compiled at its first call.

    The code is kept on disk, beside the package or in the user's cache; where neither can be
    written to, it is compiled anew in every process. Divisions are IEEE 754's, as in NumPy, and
    nothing is reordered: results are those of the code as it is written.
    """
    try:
        return cast(Function, njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no place for the cache
        return cast(Function, njit(error_model="numpy")(function))
