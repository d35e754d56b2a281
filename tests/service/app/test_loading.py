"""What a side loads before it does its first work: a start waits for all of it."""

import subprocess
import sys

import pytest
from patience import patience

pytestmark = pytest.mark.wires  # each starts a process


#: What the supervisor has loaded before it makes the processes of the sides.
SHARED = "import service.cli, service.app.serve, service.app.forking as forking; forking.preload()"
OF_THE_TWIN = {"numba", "scipy", "llvmlite"}
OF_OTHERS = {"nats", "pandas", "asammdf", "pyarrow", "matplotlib", "dask", "asyncua", "aiomqtt"}


@pytest.mark.parametrize(
    ("loads", "without", "most"),
    [
        ("", {"fastapi", "can", "pymodbus"}, 1050),
        # Devices are read before the twin is there.
        ("service.cell.start", {"fastapi"}, 80),
        ("service.web.start", set(), 380),
        ("service.plant.start", {"fastapi"}, 100),
    ],
)
def test_a_side_loads_nothing_that_its_first_work_does_not_need(
    loads: str, without: set[str], most: int
) -> None:
    program = f"import sys; before = 0\n{SHARED}\n"
    if loads:
        program += f"before = len(sys.modules)\nimport {loads}\n"
    program += "there = [name for name, module in sys.modules.items() if module is not None]\n"
    program += "print(len(there) - before, *{name.partition('.')[0] for name in there})"
    answer = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=patience(120),
        check=True,
    )
    count, *libraries = answer.stdout.split()
    assert (OF_THE_TWIN | OF_OTHERS | without) & set(libraries) == set()
    assert int(count) <= most
