"""An alarm book on a real store, moved on by hand."""

from dataclasses import replace
from pathlib import Path

from service.alarms import AlarmBook, AlarmCondition
from service.store import Alarm, AlarmTransition, Outbox, Store

SECOND_US = 1_000_000
START_US = 1_763_700_000 * SECOND_US
HOT = AlarmCondition(
    asset="bench-1",
    kind="measured limit",
    channel="t_inner_ring_c",
    level="alarm",
    active=True,
    value=106.0,
    message="Inner ring over alarm 105 °C",
    priority=1,
    limit_value=105.0,
    unit="°C",
)
COLD = replace(HOT, active=False, value=80.0)
UNKNOWN = replace(HOT, active=None, value=None)
STORED = Alarm(
    id="one",
    asset="a",
    kind="measured limit",
    channel="t_inner_ring_c",
    level="alarm",
    state="UNACK",
    priority=1,
    message="too hot",
    predicted=False,
    raised_at_us=100,
    since_us=100,
    returned_at_us=None,
    acknowledged_at_us=None,
    acknowledged_by=None,
    value=106.5,
    limit_value=105.0,
    unit="°C",
    lead_time_s=None,
    probability=None,
    present=True,
    latched=False,
    shelved_until_us=None,
    shelved_by=None,
    suppressed_reason=None,
    comment=None,
)


class HandClock:
    """Process time that a test moves on by hand."""

    rate = 60.0

    def __init__(self) -> None:
        self.us = START_US

    def now_us(self) -> int:
        return self.us

    def advance(self, seconds: float) -> None:
        self.us += round(seconds * SECOND_US)

    async def sleep(self, process_seconds: float) -> None:
        self.advance(process_seconds)


class Bench:
    """A book on a real store, with what it told its listener."""

    def __init__(self, data_dir: Path) -> None:
        self.data_dir = data_dir
        self.clock = HandClock()
        self.told: list[Alarm] = []
        self._open()

    def after(self, seconds: float, condition: AlarmCondition) -> str:
        """Move on, evaluate, and tell the state of the condition's alarm."""
        self.clock.advance(seconds)
        self.book.evaluate(condition)
        return self.state(condition)

    def state(self, condition: AlarmCondition = HOT) -> str:
        for alarm in self.book.active():
            if (alarm.asset, alarm.kind, alarm.channel, alarm.level) == condition.key:
                return alarm.state
        return "NORM"

    def only(self) -> Alarm:
        (alarm,) = self.book.active()
        return alarm

    def journal(self) -> list[AlarmTransition]:
        assert self.outbox.flush(30)
        return self.store.alarms.journal(limit=100_000).items[::-1]

    def restart(self, loaded_by_us: int | None = 0) -> None:
        self.close()
        self._open(loaded_by_us)

    def close(self) -> None:
        self.outbox.close()
        self.store.close()

    def _open(self, loaded_by_us: int | None = 0) -> None:
        self.store = Store.open("", self.data_dir)
        self.outbox = Outbox.open(self.data_dir, self.store)
        self.book = AlarmBook(self.outbox, self.clock, self.told.append, loaded_by_us=loaded_by_us)
