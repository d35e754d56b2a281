"""One run of the demo: virtual bench and service as processes, its stages reported and scored."""

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import httpx2
from pymodbus.client import AsyncModbusTcpClient

from adapters.virtual_bench import BenchAnnouncement, find_scenario
from service.demo.configuration import asset_of, write_configuration
from service.demo.processes import DemoError, Process, folder_of, running
from service.demo.score import Account
from service.demo.story import Story
from service.domain.errors import BearingTwinError
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

SCENARIO = "demo"
START_COIL = 0
HOLD_COIL = 1
#: How many specimens run first; one machine is no family.
SISTERS = 2

Result = TypeVar("Result")


class _Interrupted(BearingTwinError):  # noqa: N818 - not an error: it was asked for
    """The demo is to stop, or its time is over."""


class BenchWatch:
    """Lets work go on until the demo is to stop, its time is over or one of its processes ends."""

    def __init__(self, stop: asyncio.Event, duration_s: float | None) -> None:
        self._stop = stop
        self._deadline = (
            None if duration_s is None else asyncio.get_running_loop().time() + duration_s
        )
        self._processes: list[Process] = []

    def add(self, process: Process) -> None:
        """Watch over one more process."""
        self._processes.append(process)

    def remove(self, process: Process) -> None:
        """Let a process end without ending the demo."""
        self._processes.remove(process)

    async def until_done(self, work: Awaitable[Result]) -> Result:
        """Return what the work gives.

        Raises `_Interrupted` if the demo is to stop first; the work is cancelled then. Raises
        `DemoError` if a process ended on its own meanwhile; names it.
        """
        task = asyncio.ensure_future(work)
        others: list[asyncio.Task[Any]] = [asyncio.create_task(self._stop.wait())]
        others += [asyncio.create_task(process.wait()) for process in self._processes]
        now = asyncio.get_running_loop().time()
        left_s = None if self._deadline is None else max(self._deadline - now, 0.0)
        try:
            await asyncio.wait([task, *others], timeout=left_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for one in (task, *others):
                one.cancel()
            # The task that is done keeps its result; the others are given the time to clean up.
            await asyncio.gather(task, *others, return_exceptions=True)
        for process in self._processes:
            if process.ended and not self._stop.is_set():
                raise process.error()
        if task.cancelled():
            raise _Interrupted
        return task.result()


async def run(
    *,
    rate: float,
    port: int,
    seed: int,
    watch: BenchWatch,
    wait: bool,
    stay: bool,
    sisters: bool,
    report: Callable[[str], None],
    at_the_end: Callable[[Account], None],
) -> Account:
    """Run the demo and return its document.

    Raises `DemoError` if a part of it did not start or ended early.

    - ``wait``: whether the bench waits before a high-risk stage until the identification has ended.
    - ``stay``: whether service and page stay up after the last stage until the demo is to stop.
    - ``sisters``: run three specimens; the last one learns from the others before its high-risk
      stages.
    - ``at_the_end``: gets the document while service and page are still up.
    """
    stories: list[Story] = []
    scenario = find_scenario(SCENARIO)
    async with contextlib.AsyncExitStack() as stack:
        folder = stack.enter_context(folder_of("bearing-twin-demo-"))
        try:
            await watch.until_done(_prepare(folder, report))
            specimens = [seed + 1 + k for k in range(1 + SISTERS)] if sisters else [None]
            started = [
                await watch.until_done(_start_bench(stack, folder, rate, seed, specimen, watch))
                for specimen in specimens
            ]
            benches = [bench for _, bench in started]
            address, key = await watch.until_done(
                _start_service(stack, folder, benches, rate, port, watch)
            )
            report(f"Open {address}#key={key}")
            client = await stack.enter_async_context(
                httpx2.AsyncClient(base_url=address, headers={"X-API-Key": key}, timeout=30)
            )
            for number, bench in enumerate(benches, start=1):
                asset, is_last = asset_of(number), number == len(benches)
                stories.append(
                    Story(
                        client,
                        scenario,
                        partial(_report_of, asset, report) if sisters else report,
                        partial(set_coil, bench, HOLD_COIL) if wait else None,
                        asset,
                        SISTERS if sisters and is_last else 0,
                    )
                )
            await watch.until_done(_together(story.ready() for story in stories))
            report("The twin follows the machine at standstill; the bench starts its profile.")
            for bench in benches:
                await watch.until_done(set_coil(bench, START_COIL, True))
            try:
                await watch.until_done(_together(story.follow() for story in stories))
            except DemoError as error:
                over = [process for process, _ in started if process.ended]
                if not (stay and over):
                    raise
                for process in over:
                    watch.remove(process)
                report(f"{error}. The service goes on without its data.")
        except _Interrupted:
            pass
        if not stories:
            return NOTHING_YET
        document = await stories[-1].account()
        if sisters:
            document["sisters"] = {
                asset_of(number): (await story.account())["stages"]
                for number, story in enumerate(stories[:-1], start=1)
            }
        at_the_end(document)
        if stay:
            report("The page stays up; Ctrl-C ends the demo.")
            with contextlib.suppress(_Interrupted):
                await watch.until_done(asyncio.Event().wait())
        return document


async def _together(work: Iterable[Awaitable[None]]) -> None:
    """Do some work at the same time, as one task that can be cancelled."""
    await asyncio.gather(*work)


def _report_of(asset: str, report: Callable[[str], None], line: str) -> None:
    report(f"{asset}: {line}")


NOTHING_YET: Account = {
    "model_versions": [],
    "stages": [],
    "samples": {"modbus": 0, "can": 0},
    "complete": False,
    "forecasts_kept": {},
}


async def _prepare(folder: Path, report: Callable[[str], None]) -> None:
    """Compile the kernels once, before process time starts to run fast."""
    report("Preparing: the numerical kernels are compiled on the first run (about a minute).")
    async with running("preparation", ("warm-up",), folder / "warm-up.log"):
        pass


async def _start_bench(
    stack: contextlib.AsyncExitStack,
    folder: Path,
    rate: float,
    seed: int,
    specimen: int | None,
    watch: BenchWatch,
) -> tuple[Process, BenchAnnouncement]:
    """Start the virtual bench; its process and where it listens."""
    arguments: tuple[str, ...] = (
        "virtual-bench", "--scenario", SCENARIO, "--rate", f"{rate:g}", "--seed", str(seed),
        "--modbus-port", "0", "--can-port", "0",
        "--truth", str(folder / f"truth-{specimen or 0}.csv"),
        "--wait-for-start", "--json",
    )  # fmt: skip
    if specimen is not None:
        arguments += ("--specimen", str(specimen))
    process = await stack.enter_async_context(
        running("virtual bench", arguments, folder / "bench.log")
    )
    watch.add(process)
    return process, json.loads(process.first_line)


async def _start_service(
    stack: contextlib.AsyncExitStack,
    folder: Path,
    benches: Sequence[BenchAnnouncement],
    rate: float,
    port: int,
    watch: BenchWatch,
) -> tuple[str, str]:
    """Start the service; its address and an API key."""
    configuration = write_configuration(folder, benches, rate, port)
    settings = load_settings(configuration)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        key = create_key(store, "admin").text
    process = await stack.enter_async_context(
        running("service", ("serve", "-c", str(configuration)), folder / "service.log")
    )
    watch.add(process)
    return process.first_line, key


async def set_coil(bench: BenchAnnouncement, coil: int, value: bool) -> None:
    """Set a coil of the bench controller, as a SCADA system would.

    Raises `DemoError` if the controller refuses it.
    """
    async with AsyncModbusTcpClient(
        bench["modbus"]["host"], port=bench["modbus"]["port"], timeout=15
    ) as modbus:
        answer = await modbus.write_coil(coil, value, device_id=2)
        if answer.isError():
            raise DemoError(f"the bench refused coil {coil} = {value}: {answer}")
