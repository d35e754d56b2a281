"""Kernels of the bench beside a cache that an earlier version has left."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import adapters

_COMPILE = """
from adapters.virtual_bench.friction import grease_condition
grease_condition(0.5, 0.1)
"""


@pytest.mark.wires
def test_a_change_of_any_module_of_the_bench_begins_a_new_cache(tmp_path: Path) -> None:
    """An index names classes of other modules; numba reads all of it before it looks at dates."""
    package = tmp_path / "adapters"
    here = Path(adapters.__file__).parent
    shutil.copytree(here, package, ignore=shutil.ignore_patterns("__pycache__"))
    cache = tmp_path / "cache"
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", _COMPILE]
    subprocess.run(command, env=environment, cwd=tmp_path, check=True)
    [index] = cache.rglob("*.nbi")
    subprocess.run(command, env=environment, cwd=tmp_path, check=True)
    assert list(cache.rglob("*.nbi")) == [index], "the same again is read from the cache"
    index.write_bytes(index.read_bytes()[:-10])  # no reader gets through this one
    with (package / "virtual_bench" / "network.py").open("a") as file:
        file.write("\n# another version\n")
    subprocess.run(command, env=environment, cwd=tmp_path, check=True)
    assert len(list(cache.rglob("*.nbi"))) == 2
