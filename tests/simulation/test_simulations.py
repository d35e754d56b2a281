"""Orderings are proved by simulation: the product's own code over a fake server, bus, disk, clock.

A failure names its seed and the last steps. To see it again:
``BEARING_TWIN_SEED=27 python -m pytest tests/simulation -k promises``. For longer:
``BEARING_TWIN_SIMULATED_DAYS=1000 python -m pytest -m endurance -s tests/simulation``.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from simulation.acts import simulate
from simulation.before import judged_while_blind, refused_is_dropped, sent_before_the_fence
from simulation.fleet import product_order
from simulation.judgement import simulate_judgement
from simulation.web import simulate_web
from simulation.world import BrokenError

SEED = os.environ.get("BEARING_TWIN_SEED")
DAYS = float(os.environ.get("BEARING_TWIN_SIMULATED_DAYS", "20"))


@pytest.fixture
def folder() -> Iterator[Path]:
    """In memory, where the machine has such a place: a sync of a disk is real time."""
    memory = Path("/dev/shm")
    place = memory if memory.is_dir() else None
    with tempfile.TemporaryDirectory(prefix="bt-", dir=place) as name:
        yield Path(name)


@pytest.mark.parametrize("seed", [int(SEED)] if SEED else range(2))
def test_a_fleet_keeps_its_promises(folder: Path, seed: int) -> None:
    fleet = simulate(seed, folder, 1.0 if SEED else 0.3)
    assert len(fleet.acknowledged) > 100


@pytest.mark.parametrize("seed", [int(SEED)] if SEED else range(2))
def test_a_web_process_keeps_its_promises(seed: int) -> None:
    site = simulate_web(seed, 1.0 if SEED else 0.4)
    assert site.safe > 100
    assert site.messages > 100
    assert site.gaps, "no client was told of a gap: nothing has happened"


@pytest.mark.parametrize("seed", [int(SEED)] if SEED else range(5))
def test_the_supervisor_keeps_its_promises(seed: int) -> None:
    simulate_judgement(seed, 3.0)


def test_a_seed_gives_the_same_run_again(folder: Path) -> None:
    traces = []
    for name in "ab":
        (folder / name).mkdir()
        fleet = simulate(11, folder / name, 0.2)
        traces.append((list(fleet.world.trace), fleet.world.counts, fleet.acknowledged))
    assert traces[0] == traces[1]


@pytest.mark.parametrize(
    ("seed", "before", "order", "knows_its_store", "act", "what"),
    [
        # Item 23: an older copy is not noticed.
        (2, nullcontext, product_order, False, "fail over to an older copy", "alarms differ"),
        # Item 24: the outbox of a killed cell is sent before the fence is set.
        (3, refused_is_dropped, sent_before_the_fence, True, "cut and kill", "writes an alarm of"),
        # Item 25: who comes back first after a pause of the server ends the others.
        (0, judged_while_blind, product_order, True, "freeze the server", "was ended though"),
    ],
    ids=["23", "24", "25"],
)
def test_what_was_wrong_before_is_found(
    folder: Path,
    seed: int,
    before: Callable[[], Any],
    order: Any,
    knows_its_store: bool,
    act: str,
    what: str,
) -> None:
    """With the rules of commit 8c379b4; the same seeds pass with those of today."""
    for name in ("before", "today"):
        (folder / name).mkdir()
    with before(), pytest.raises(BrokenError, match=what):
        simulate(seed, folder / "before", 0.25, order, knows_its_store, only=[act])
    simulate(seed, folder / "today", 0.25, only=[act])


@pytest.mark.endurance
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("what", ["fleet", "web"])
def test_many_days(folder: Path, what: str) -> None:
    """Prints the service-days of a processor hour; asked are 1,000."""
    began_s = time.process_time()
    for seed in range(1000, 1000 + round(DAYS)):
        if what == "fleet":
            (folder / str(seed)).mkdir()
            simulate(seed, folder / str(seed), 1.0)
        else:
            simulate_web(seed, 1.0)
    a_day_s = (time.process_time() - began_s) / DAYS
    print(f"{what}: {DAYS:g} service-days, {3600 / a_day_s:,.0f} in a processor hour")  # noqa: T201
