"""The background worker process."""

import os
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool

import pytest
from patience import patience

from service.jobs.executor import make_executor


def test_the_worker_is_another_process_of_lower_priority() -> None:
    with make_executor() as executor:
        assert executor.submit(os.getpid).result(180) != os.getpid()
        # 19 is as low as it goes; the tests themselves may be run at a low priority.
        assert executor.submit(os.nice, 0).result(180) == min(os.nice(0) + 10, 19)


def test_a_killed_worker_is_noticed() -> None:
    with make_executor() as executor, pytest.raises(BrokenProcessPool):
        executor.submit(os._exit, 9).result(180)


@pytest.mark.wires
def test_numba_may_be_given_less_than_the_machine_has() -> None:
    """A container's share, or the user's wish: a worker must not ask for more threads."""
    prepare = (
        "import os; os.cpu_count = lambda: 8\n"
        "from service.jobs.executor import prepare_worker\n"
        "prepare_worker()\n"
        "import numba; print(numba.config.NUMBA_NUM_THREADS)"
    )
    found = subprocess.run(
        [sys.executable, "-c", prepare],
        env=os.environ | {"NUMBA_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        timeout=patience(180),
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == "1"
