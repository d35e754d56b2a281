from dataclasses import replace

import pytest
from sqlalchemy.exc import IntegrityError

from service.store import Alarm, AlarmTransition, Store

ALARM = Alarm(
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
)


def line(time_us: int, alarm: Alarm = ALARM) -> AlarmTransition:
    return AlarmTransition(
        alarm_id=alarm.id,
        asset=alarm.asset,
        kind=alarm.kind,
        channel=alarm.channel,
        level=alarm.level,
        time_us=time_us,
        from_state="NORM",
        to_state="UNACK",
        who="service",
        comment="",
        value=alarm.value,
        message=alarm.message,
    )


def test_an_alarm_is_kept_until_it_is_over(store: Store) -> None:
    store.save_alarm(ALARM, [line(100)])
    assert store.load_alarms() == [ALARM]
    acked = replace(ALARM, state="ACKED", acknowledged_by="eva", acknowledged_at_us=150)
    store.save_alarm(acked)
    assert store.load_alarms() == [acked]
    store.save_alarm(replace(acked, state="NORM", returned_at_us=200), [line(200)])
    assert store.load_alarms() == []
    again = replace(ALARM, id="two", raised_at_us=300)
    store.save_alarm(again, [line(300, again)])
    assert store.load_alarms() == [again]
    assert [one.time_us for one in store.alarm_journal().items] == [300, 200, 100]


def test_of_one_condition_one_alarm_is_open(store: Store) -> None:
    store.save_alarm(ALARM)
    store.save_alarm(replace(ALARM, id="other level", level="warning"))
    with pytest.raises(IntegrityError):
        store.save_alarm(replace(ALARM, id="two"), [line(5, replace(ALARM, id="two"))])
    assert len(store.load_alarms()) == 2
    assert store.alarm_journal().items == []  # the line went with the alarm


def test_the_journal_comes_in_pages_newest_first(store: Store) -> None:
    for time_us in range(7):
        store.save_alarm(ALARM, [line(time_us)])
    seen = []
    cursor = None
    while True:
        page = store.alarm_journal(start_us=1, end_us=6, limit=2, cursor=cursor)
        seen += [one.time_us for one in page.items]
        cursor = page.next_cursor
        if cursor is None:
            break
        assert len(page.items) == 2
    assert seen == [5, 4, 3, 2, 1]
    assert store.alarm_journal(limit=7).next_cursor is None
    assert store.alarm_journal(limit=1).items == [line(6)]
