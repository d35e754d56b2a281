"""How the bench's kernels are compiled and cached."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Any:
    """Compile without the GIL, cached on disk.

    numba notices neither a change of the functions that a kernel calls nor one of its named
    tuples, and it fails where the cache of an earlier version names a class that is gone. The name
    under which the code is cached therefore carries a digest of all modules of the bench.
    """
    function.__qualname__ += f"_{_DIGEST}"
    return njit(cache=True, nogil=True)(function)


def _digest() -> str:
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


_DIGEST = _digest()
