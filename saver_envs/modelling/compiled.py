"""Compile loops over arms and joints with Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function to machine code at its first call.

    The code is cached on disk, next to the package or in the user's cache folder; if neither is
    writable, every process compiles again. Division follows IEEE 754, as in NumPy, and operations
    are not reordered, so results match the written code.
    """
    try:
        return cast(Function, njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # no writable cache folder
        return cast(Function, njit(error_model="numpy")(function))
