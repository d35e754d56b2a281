"""Loading of libraries without collections of garbage, which would look through all of them."""

import contextlib
import gc
import importlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def loading() -> Iterator[None]:
    """Load modules without collections of garbage, which took a quarter of a start.

    What is there at the end is kept out of later collections: it stays as long as the process.
    Processes that are made by a fork share it as long as none writes to it; a collection would.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()


def load_numba() -> None:
    """Load numba's functions of arrays without scipy's linear algebra, which no kernel calls.

    It would take a quarter of a second and 25 MB in each process. A kernel that calls `numpy.dot`
    or `numpy.linalg` does not compile then; those of `twin_core.simulation.linear` do.
    """
    load_without("scipy.linalg.cython_blas", "numba.np.arraymath")


def load_without(optional: str, name: str) -> None:
    """Load a module as if a library that it uses where it finds it were not installed."""
    if name in sys.modules or optional in sys.modules:
        return
    sys.modules[optional] = None  # type: ignore[assignment]  # an import raises ImportError
    try:
        importlib.import_module(name)
    finally:
        del sys.modules[optional]
