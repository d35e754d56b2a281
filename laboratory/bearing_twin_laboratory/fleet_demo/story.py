"""What is done to the fleet, part by part, and what is seen of it."""

import asyncio
import json
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from bearing_twin_laboratory.benchmarks.fleet import answers_of
from bearing_twin_laboratory.fleet_demo.alarms import (
    Alarms,
    disagreement,
    raise_and_acknowledge,
    raised_again,
    until_same,
)
from bearing_twin_laboratory.fleet_demo.ledger import Count
from bearing_twin_laboratory.fleet_demo.parts import Part
from bearing_twin_laboratory.fleet_demo.site import NIGHT_FAMILY
from bearing_twin_laboratory.fleet_demo.stand import CELLS, Report, Stand
from service.demo.processes import DemoError
from service.store import Store

#: Wall seconds for which PostgreSQL is away.
DATABASE_AWAY_S: Final = 3.0
#: For the last samples to get from the disks of the cells into the store.
_STORED_S: Final = 90.0
#: For all else, on a busy machine.
_END_S: Final = 600.0
_LOOK_EVERY_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class Act:
    """One part killed, and what came of it.

    - ``owned_s``: wall seconds until every partition had an owner that lives; None where none lost
      its own.
    - ``fresh_s``: wall seconds until the web processes gave fresh values of all watched assets.
    - ``polls_skipped``: polls that were due meanwhile and did not come.
    """

    what: str
    owned_s: float | None
    fresh_s: float
    polls_skipped: int


@dataclass(frozen=True, slots=True)
class Account:
    """The end of the story."""

    acts: list[Act]
    count: Count
    rejected: int
    pushes_repeated: int
    longest_without_owner_s: float
    stale_writes_refused: int
    stale_writes_accepted: int
    polls_skipped: int
    alarms_raised_again: int
    alarms_disagree: list[str]
    changes_refused: int
    answers: dict[str, int]
    wrong_answers: list[str]
    stream: dict[str, float]
    wrong_messages: list[str]

    @property
    def is_clean(self) -> bool:
        """Whether nothing is lost, doubled, out of order, raised again or answered wrongly.

        Also whether the open alarms of the store were those of the owners after each act.
        """
        return (
            self.count.is_clean
            and not self.rejected
            and not self.stale_writes_accepted
            and not self.alarms_raised_again
            and not self.alarms_disagree
            and not self.wrong_answers
            and not self.wrong_messages
        )

    def document(self) -> dict[str, object]:
        """As a JSON document."""
        whole = asdict(self)
        count = whole.pop("count")
        return {"clean": self.is_clean, "ledger": count, **whole}


class Story:
    """Kills parts of a running fleet; `account` says at the end what is lost.

    - ``stand``: the fleet.
    - ``report``: takes one line for the person who watches.
    """

    def __init__(self, stand: Stand, report: Report) -> None:
        self.stand = stand
        self.acts: list[Act] = []
        self._report = report
        self._alarms: Alarms = {}
        self._disagree: list[str] = []

    async def begin(self) -> None:
        """Have alarms raised and some of them acknowledged, before anything is killed."""
        async with self.stand.client() as client:
            self._alarms = await raise_and_acknowledge(client, self.stand.pushed)
        # The other web process may give an answer of a moment ago.
        await asyncio.sleep(1.0)
        self.stand.watcher.alarms = self._alarms
        acknowledged = sum(state == "ACKED" for state in self._alarms.values())
        self._report(f"{len(self._alarms)} alarms are open, {acknowledged} of them acknowledged.")

    # ------------------------------------------------------------------ acts
    async def kill_cell(self, place: int = 0) -> None:
        """Kill a cell at once."""
        cell = self.stand.cells[place]
        run = self.stand.run_of(cell)
        self._report(f"kill -9 of {cell.name}: the other cell is to take its partitions over.")

        async def kill() -> float:
            cell.send(signal.SIGKILL)
            return await self.stand.witness.until_owned({run})

        await self._act(f"kill -9 of {cell.name}", kill)
        await self._back(cell)

    async def pause_cell(self, place: int = 0) -> None:
        """Stop a cell until another one has its partitions, and let it go on."""
        cell = self.stand.cells[place]
        run, ends = self.stand.run_of(cell), cell.ends
        self._report(f"SIGSTOP of {cell.name}: it hangs, its connections stay.")

        async def pause() -> float:
            cell.send(signal.SIGSTOP)
            try:
                return await self.stand.witness.until_owned({run})
            finally:
                self._report(
                    f"SIGCONT of {cell.name}: it wakes up and still takes itself for owner."
                )
                cell.send(signal.SIGCONT)

        await self._act(f"SIGSTOP and SIGCONT of {cell.name}", pause)
        await _until(lambda: cell.ends > ends, f"the end of the woken {cell.name}")
        self._report(f"{cell.name} has seen that its partitions are lost, and has ended itself.")
        await self._back(cell)

    async def kill_web(self, place: int = 0) -> None:
        """Kill a web process; clients that push go to the other."""
        web = self.stand.webs[place]
        self._report(f"kill -9 of {web.name}: the pusher goes to the other one.")

        async def kill() -> None:
            web.send(signal.SIGKILL)

        await self._act(f"kill -9 of {web.name}", kill)
        began_s = time.monotonic()
        await web.is_up_again()
        self._report(f"{web.name} answers again after {time.monotonic() - began_s:.1f} s more.")

    async def kill_nats(self) -> None:
        """Kill NATS; it comes back some seconds later."""
        self._report("kill -9 of NATS: cells go on; the web processes hear nothing from them.")

        async def kill() -> None:
            self.stand.nats.send(signal.SIGKILL)
            await self.stand.nats.is_up_again()

        await self._act("kill -9 of NATS", kill)

    async def restart_database(self) -> None:
        """Stop PostgreSQL and start it again: no cell loses its partitions."""
        self._report(f"PostgreSQL is stopped, and started again {DATABASE_AWAY_S:.0f} s later.")

        async def restart() -> float:
            began_s = time.monotonic()
            await self.stand.database.restart(DATABASE_AWAY_S)
            await self.stand.witness.until_owned(least_cells=CELLS)
            return time.monotonic() - began_s

        await self._act("restart of PostgreSQL", restart)

    async def identify_at_night(self) -> None:
        """Identify some machines on the Dask cluster; a worker is killed meanwhile."""
        stand, victim = self.stand, self.stand.workers[0]
        self._report(
            f"fleet identify: {len(stand.nights)} machines on two Dask workers; "
            f"kill -9 of {victim.name} once as it computes."
        )
        document: dict[str, Any] = {}

        async def night() -> None:
            nonlocal document
            document = await _identified(stand, victim)

        await self._act(f"kill -9 of Dask {victim.name}", night)
        with stand.open_store() as store:
            jobs = {
                name: [job.status for job in store.jobs.of_asset(name)] for name in stand.nights
            }
        # Beside the night, cells identify by themselves what has new data.
        wrong = [name for name, ended in jobs.items() if set(ended) != {"succeeded"}]
        if document["failed"] or wrong:
            raise DemoError(f"not all identified: {jobs}")
        self._report(
            f"{document['machines']} machines are identified, each once, in "
            f"{document['seconds']:.0f} s; workers lost: {document['workers_lost']}."
        )

    # ------------------------------------------------------------------ end
    async def account(self) -> Account:
        """Stop pushing, wait for what is on the disks, and compare."""
        stand = self.stand
        self._report("The pusher stops; the ledger is compared with the store.")
        stand.pusher.stop()
        await asyncio.wait_for(stand.pushing, _STORED_S)
        began_s = time.monotonic()
        with stand.open_store() as store:
            while True:
                count = await asyncio.to_thread(stand.pusher.count, store)
                if count.is_clean or time.monotonic() - began_s > _STORED_S:
                    break
                await asyncio.sleep(1.0)
            return await self._account(store, count)

    async def account_so_far(self) -> Account:
        """Compare with the store as it is now, where the story ends before its end.

        Raises `StoreError` if the store does not answer.
        """
        with self.stand.open_store() as store:
            return await self._account(
                store, await asyncio.to_thread(self.stand.pusher.count, store)
            )

    async def _account(self, store: Store, count: Count) -> Account:
        stand = self.stand
        seen, followed = stand.watcher.seen, stand.reader.followed
        return Account(
            acts=self.acts,
            count=count,
            rejected=stand.pusher.rejected,
            pushes_repeated=stand.pusher.refused,
            longest_without_owner_s=stand.witness.longest_s,
            stale_writes_refused=stand.refused_writes(),
            stale_writes_accepted=await stand.witness.stale_writes(),
            polls_skipped=sum(act.polls_skipped for act in self.acts),
            alarms_raised_again=raised_again(store, self._alarms),
            alarms_disagree=self._disagree,
            changes_refused=len(store.refused.list()),
            answers=seen.counts(),
            wrong_answers=seen.wrong,
            stream={
                "messages": followed.messages,
                "connections": followed.connections,
                "gaps_told": followed.gaps_told,
                "longest_silence_s": followed.longest_silence_s,
            },
            wrong_messages=followed.wrong,
        )

    async def _act(self, what: str, fault: Callable[[], Awaitable[float | None]]) -> None:
        """Do something to the fleet, wait until all is well, and report what was seen."""
        stand = self.stand
        benches = stand.benches["benches"]
        polled, began_s = sum(await answers_of(stand.benches["modbus"])), time.monotonic()
        owned_s = await fault()
        fresh_s = await stand.until_fresh(time.monotonic()) if owned_s is None else None
        if fresh_s is None:
            fresh_s = await stand.until_fresh(began_s + (owned_s or 0.0)) + (owned_s or 0.0)
        async with stand.client(1 if "web 1" in what else 0) as client:
            await until_same(client, self._alarms)
            with stand.open_store() as store:
                differing = await disagreement(client, store)
        self._disagree += (f"after {what}: {one}" for one in differing)
        passed_s = time.monotonic() - began_s
        polled = sum(await answers_of(stand.benches["modbus"])) - polled
        skipped = max(0, round(benches * passed_s) - polled)
        if owned_s is not None:
            stand.witness.longest_s = max(stand.witness.longest_s, owned_s)
            self._report(f"All partitions are owned again after {owned_s:.1f} s.")
        self._report(
            f"Fresh values of all watched assets after {fresh_s:.1f} s, and the same alarms; "
            f"{skipped} of {round(benches * passed_s)} polls skipped."
        )
        self.acts.append(Act(what, owned_s, fresh_s, skipped))

    async def _back(self, cell: Part) -> None:
        await cell.is_up_again()
        await self.stand.witness.until_owned(least_cells=CELLS)
        self._report(f"{cell.name} is started again and has its share of the partitions.")


async def _until(look: Callable[[], bool], what: str) -> None:
    began_s = time.monotonic()
    while not look():
        if time.monotonic() - began_s > _END_S:
            raise DemoError(f"not within {_END_S:g} s: {what}")
        await asyncio.sleep(_LOOK_EVERY_S)


async def _identified(stand: Stand, victim: Part) -> dict[str, Any]:
    """Run the command, kill a worker when it computes, and return the command's document."""
    log = stand.folder / "identify.log"
    with log.open("ab") as errors:
        command = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "service", "fleet", "identify", "--json",
            "--family", NIGHT_FAMILY, "-c", str(stand.configuration),
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            process_group=0,
        )  # fmt: skip
    try:
        before_s = processor_s(victim.pid)
        await _until(
            lambda: processor_s(victim.pid) > before_s + 0.3 or command.returncode is not None,
            "a batch in a worker",
        )
        victim.send(signal.SIGKILL)
        output, _ = await command.communicate()
    finally:
        if command.returncode is None:
            command.kill()
            await command.wait()
    if command.returncode != 0:
        raise DemoError(f"fleet identify ended with status {command.returncode}: see {log}")
    document: dict[str, Any] = json.loads(output)
    return document


def processor_s(pid: int) -> float:
    """Processor seconds that a process has used; 0 where there is none."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return 0.0
    user, system = text.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / 100.0
