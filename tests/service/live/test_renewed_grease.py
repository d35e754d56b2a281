"""The grease of a machine is renewed while its twin runs."""

import asyncio
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import pytest

from service.cell.keeping import StateKeeper
from service.domain.errors import NotReadyError
from service.live.kept import KeptState
from service.store import AuditEntry

from .warm_machine import WARM, running

PATIENCE_S = 30.0


async def test_renewed_grease_counts_from_zero_and_after_a_restart_too(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    with pytest.raises(NotReadyError):
        await live.runtime.renew_grease("engineer eva", "")
    await running(live, WARM)
    await live.until(lambda: live.documents.state().revolutions > 1000, "turning", WARM)
    live.saved.clear()
    answer = await live.runtime.renew_grease("engineer eva", "regreased")
    assert answer.revolutions_before > 1000
    assert answer.revolutions == 0
    assert live.saved[0]["observer"]["revolutions"] == 0.0
    await live.stop()
    again = make_live()
    again.start(json.loads(json.dumps(live.saved[0])))
    await asyncio.sleep(0)
    assert again.runtime.estimate.revolutions == 0.0
    assert live.alarms._outbox.flush(30)
    (event,) = [line for line in live.store.alarms.journal().items if line.kind == "grease renewed"]
    assert (event.who, event.comment) == ("engineer eva", "regreased")


async def test_the_line_of_renewed_grease_is_kept_with_the_first_state_that_has_it(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    await running(live, WARM)
    line = AuditEntry(1, "engineer eva", "", "asset.grease-renewed")
    live.store_is_away = True
    with pytest.raises(OSError, match="no space left"):
        await live.runtime.renew_grease("engineer eva", "", line)
    live.store_is_away = False
    live.saved.clear()
    await live.until(lambda: live.saved, "the next state", WARM)
    await live.runtime.saving.keep()
    assert live.audit == [line], "once, with the state that has it"


async def test_a_line_on_its_way_is_not_sent_again_when_who_waits_for_it_leaves(
    make_live: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = make_live()
    await running(live, WARM)
    begun, go_on = threading.Event(), threading.Event()
    written: list[AuditEntry] = []

    def write(documents: Mapping[str, KeptState], lines: Sequence[AuditEntry]) -> None:
        begun.set()
        go_on.wait(PATIENCE_S)
        written.extend(lines)

    save = partial(StateKeeper(write).save, live.runtime.id)
    monkeypatch.setattr(live.runtime.saving, "_save_state", save)
    line = AuditEntry(1, "engineer eva", "", "asset.grease-renewed")
    calling = asyncio.create_task(live.runtime.renew_grease("engineer eva", "", line))
    assert await asyncio.to_thread(begun.wait, PATIENCE_S)
    calling.cancel()
    await asyncio.wait({calling})
    go_on.set()
    await live.runtime.saving.keep()
    assert written == [line]
