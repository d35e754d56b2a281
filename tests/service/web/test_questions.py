"""Questions to a worker: what they are about reaches its process, and its refusal comes back."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from site_files import asset_text

from service.bus.memory import MemoryBus
from service.bus.replica import AssetReplica
from service.domain.errors import CellUnavailableError, NotReadyError
from service.site.settings import load_settings
from service.store import Store
from service.web import worker
from service.web.questions import WorkerQuestions
from service.web.worker import Asked

CONFIGURATION = '[service]\ndata_dir = "data"\n' + asset_text(
    "bench-1", ("speed_rpm", "t_outer_ring_c")
)


@contextlib.asynccontextmanager
async def asked_asset(folder: Path, name: str) -> AsyncIterator[AssetReplica]:
    (folder / "bench.toml").write_text(CONFIGURATION)
    (folder / "data").mkdir()
    settings = load_settings(folder / "bench.toml")
    with Store.open("", settings.data_dir) as store:
        questions = WorkerQuestions(settings, store)
        running = asyncio.create_task(questions.run(lambda: False))
        await asyncio.sleep(0)
        try:
            yield AssetReplica(name, MemoryBus(), questions)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


@pytest.mark.wires
async def test_a_question_of_the_store_is_answered_without_the_cell(tmp_path: Path) -> None:
    async with asked_asset(tmp_path, "bench-1") as asset:
        assert await asset.compute(worker.windows) == []
        with pytest.raises(CellUnavailableError):
            await asset.compute(worker.envelope)  # which is about the present state


@pytest.mark.wires
async def test_the_workers_refusal_is_the_callers(tmp_path: Path) -> None:
    async with asked_asset(tmp_path, "bench-9") as asset:
        with pytest.raises(NotReadyError, match="'bench-9' was removed"):
            await asset.compute(worker.windows)


def test_a_question_about_a_state_that_is_not_there_is_refused() -> None:
    with pytest.raises(NotReadyError, match="first good temperatures"):
        worker.envelope(Asked("bench-1"))
