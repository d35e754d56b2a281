"""How the numerical kernels are compiled and cached."""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

# What a compiler may do to floating-point code beyond the letter: contract and reorder sums, so
# that they run on vectors. Not among them: "nnan" and "ninf", a failed simulation is found by them.
_FAST_MATH = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: Callable[..., Any], *, inlined: bool = False) -> Any:
    """Compile without the GIL, cached on disk where any cache folder is writable.

    numba notices a change of the file in which a function stands, but not of the functions that
    it calls, of the named tuples that it is given, nor of the constants that it takes from
    elsewhere; and it fails where the cache of an earlier version names a class that is gone. The
    name under which the code is cached therefore carries a digest of all of them, which makes it
    safe to call across modules (by the function's own name, not through a module's).
    """
    function.__qualname__ += f"_{_digest(function)}"
    # Wrappers for callers in C are left out: nobody calls from there, and they take compile time.
    options = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": _FAST_MATH,
        "no_cfunc_wrapper": True,
        "forceinline": inlined,
    }
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:
        # Neither the package folder nor the user's cache folder can be written.
        return njit(**options)(function)


def kernel_array(values: ArrayLike) -> NDArray[np.float64]:
    """Array of the one kind that kernels are given: float64, contiguous, writeable.

    For read-only arrays numba would compile code of their own, which may round differently.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        flags = values.flags
        if flags.c_contiguous and flags.writeable and type(values) is np.ndarray:
            return values
    return np.require(values, np.float64, ["C", "W"])


def _digest(function: Callable[..., Any]) -> str:
    """Digest of a function's code and types, of the numbers it names and the kernels it calls."""
    code = function.__code__
    parts = [code.co_code, repr(code.co_consts).encode(), repr(code.co_names).encode()]
    parts += [_form(kind).encode() for kind in function.__annotations__.values()]
    for name in code.co_names:
        value: Any = function.__globals__.get(name)
        if isinstance(value, int | float):
            parts.append(repr(value).encode())
        elif hasattr(value, "_fields"):
            parts.append(_form(value).encode())
        elif hasattr(value, "py_func"):  # compiled before, its name carries its own digest
            parts.append(value.py_func.__qualname__.encode())
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:12]


def _form(kind: Any) -> str:
    """Name of a type; of a named tuple also its fields, whose order is that of the compiled one."""
    if not hasattr(kind, "_fields"):
        return str(kind)
    fields = ", ".join(f"{name} {_form(of)}" for name, of in kind.__annotations__.items())
    return f"{kind.__module__}.{kind.__qualname__} ({fields})"
