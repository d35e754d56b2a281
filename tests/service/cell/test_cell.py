"""The list of parts that a cell is."""

from contextlib import closing
from functools import partial
from pathlib import Path

from anyio import to_thread

from service.bus.memory import MemoryBus
from service.cell.acquisition import Acquisition
from service.cell.cell import Cell
from service.cell.cell_clock import CellClock
from service.cell.kernels import Kernels
from service.clock import ProcessClock
from service.ingest import Spool
from service.site.settings import load_settings
from service.site.wiring import wire
from service.store import Outbox, Store


async def test_parts_stop_before_those_that_they_need(tmp_path: Path) -> None:
    (tmp_path / "twin.toml").write_text('[service]\ndata_dir = "data"\n')
    settings = load_settings(tmp_path / "twin.toml")
    settings.data_dir.mkdir()
    clock = CellClock(ProcessClock(), settings.data_dir)
    with (
        Store.open("", settings.data_dir) as store,
        Outbox.open(settings.data_dir, store) as outbox,
        closing(Spool.open(settings.data_dir, 64)) as spool,
    ):
        acquisition = Acquisition(wire(settings), clock, spool)
        make = partial(Cell, settings, wire(settings), store, outbox, clock, acquisition)
        cell = await to_thread.run_sync(make, MemoryBus(), Kernels(True))
    # They stop in the opposite order.
    started = [part.name for part in cell.core.parts]
    assert started[0] == "forecast ledger", "forecasts of the others end in it"
    assert started.index("jobs") < started.index("teaching"), "it uses the workers of jobs"
