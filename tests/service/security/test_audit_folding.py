"""What anybody may cause as often as he likes leaves one line a minute for each address."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from patience import within

from service.security import audit_trail
from service.security.audit_trail import AuditTrail
from service.security.keys import Actor
from service.store import AuditEntry, Outbox, Store

REFUSED = "key.refuse"


@pytest.fixture
def outbox(store: Store, tmp_path: Path) -> Iterator[Outbox]:
    with Outbox.open(tmp_path, store) as outbox:
        yield outbox


async def lines_when(store: Store, outbox: Outbox, count: int) -> list[AuditEntry]:
    """Wait for so many lines, oldest first."""
    async with within(60):
        while True:
            assert await asyncio.to_thread(outbox.flush, 30)
            lines = store.audit.page().items
            if len(lines) >= count:
                return list(lines)[::-1]
            await asyncio.sleep(0.02)


async def test_repetitions_are_counted_and_written_when_the_minute_is_over(
    store: Store, outbox: Outbox
) -> None:
    trail = AuditTrail(outbox, fold_s=0.5)
    for number in range(500):
        await trail.note_repeated(Actor("unknown", "203.0.113.9"), REFUSED, f"key {number}")
    await trail.note_repeated(Actor("unknown", "203.0.113.10"), REFUSED, "another address")
    # What is counted adds up, however many minutes it took.
    async with within(60):
        while trail._folds:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.02)
    lines = await lines_when(store, outbox, 3)
    mine = [line for line in lines if line.address == "203.0.113.9"]
    assert mine[0].detail == "key 0"
    # The first of each minute has a line of its own, the others are counted in one.
    counts = [line.detail.partition(" more within 0.5 s")[::2] for line in mine]
    assert sum(int(words) if rest else 1 for words, rest in counts) == 500
    assert mine[-1].detail.endswith("key 499")
    assert [line.detail for line in lines if line.address.endswith(".10")] == ["another address"]


async def test_lines_of_one_network_are_one_and_the_rest_is_written_at_the_end(
    store: Store, outbox: Outbox
) -> None:
    trail = AuditTrail(outbox)
    for number in range(40):
        await trail.note_repeated(Actor("unknown", f"2001:db8::{number:x}"), REFUSED, "wrong")
    assert len(await lines_when(store, outbox, 1)) == 1
    trail.settle()
    first, rest = await lines_when(store, outbox, 2)
    assert first.detail == "wrong"
    assert rest.detail == "39 more within 60 s, the last: wrong"


async def test_many_addresses_do_not_fill_memory(
    store: Store, outbox: Outbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audit_trail, "_MOST_FOLDS", 10)
    trail = AuditTrail(outbox)
    for number in range(25):
        await trail.note_repeated(Actor("unknown", f"198.18.0.{number}"), REFUSED, "wrong")
    assert len(trail._folds) == 11
    trail.settle()
    lines = await lines_when(store, outbox, 12)
    assert (lines[-1].address, lines[-1].detail) == (
        "several",
        "14 more within 60 s, the last: wrong",
    )
