"""After a change of alarm settings no part of the running twin shows or uses the old limit."""

import json
from collections.abc import Callable
from typing import Any

from site_files import asset_section

from service.features.alarm_settings.part import AlarmTuning
from service.store import AuditEntry

LINE = AuditEntry(time_us=1, who="engineer", address="", action="a", target="", detail="")
NAME = ("measured limit", "t_inner_ring_c", "warning")
#: A limit that no other figure of the documents is by chance.
OLD, NEW = 71.1234, 55.4321


def everything(live: Any) -> str:
    """All that the cell says of the asset, and what the web side computes from it."""
    documents = live.documents
    forecast = documents.forecast()
    assert forecast is not None
    said = [
        documents.summary(),
        documents.verdict(),
        documents.asset_summary(),
        forecast.model_copy(update={"nodes": {}}),
    ]
    alarms = [(one.message, one.limit_value) for one in live.alarms.active()]
    return " ".join(
        [*(one.to_bytes().decode() for one in said), json.dumps(documents.snapshot()), str(alarms)]
    )


async def test_no_part_shows_the_old_limit_and_alarms_keep_their_ids(
    make_live: Callable[..., Any], machine_at_rest: dict[str, float]
) -> None:
    limits = {"t_inner_ring_c": {"warning": OLD, "alarm": 95.0}}
    live = make_live(asset_section(limits=limits))
    tuning = AlarmTuning(live.store, {"bench-1": live.runtime})
    tuning.read_store()
    tuning.settle(live.runtime)
    hot = machine_at_rest | {"t_inner_ring_c": 80.0, "speed_rpm": 2400.0}
    live.start()

    def of_the_limit() -> Any:
        found = [one for one in live.alarms.active() if (one.kind, one.level) == (NAME[0], NAME[2])]
        return found[0] if found else None

    before = await live.until(of_the_limit, "the alarm", hot)
    await live.until(lambda: live.documents.forecast(), "a forecast", hot)
    assert str(OLD) in everything(live)
    change = {("bench-1", NAME): {"setpoint": NEW, "priority": 1}}
    live.store.alarm_overlays.change(change, LINE, "lower", 0)
    await tuning.apply_changes()
    # At once: the document, the verdict, and no forecast of the old limit.
    assert live.documents.summary().limits["t_inner_ring_c"].warning == NEW
    assert str(OLD) not in live.documents.verdict().to_bytes().decode()
    assert live.documents.forecast() is None
    await live.until(lambda: live.documents.forecast(), "the next forecast", hot)
    after = await live.until(
        lambda: (one := of_the_limit()) and one.limit_value == NEW and one, "the new limit", hot
    )
    assert (after.id, after.priority, after.state) == (before.id, 1, before.state)
    shown = everything(live)
    assert str(OLD) not in shown
    assert str(NEW) in shown
    # And back.
    live.store.alarm_overlays.change({("bench-1", NAME): {}}, LINE, "back", 1)
    await tuning.apply_changes()
    assert live.documents.summary().limits["t_inner_ring_c"].warning == OLD


async def test_a_twin_that_is_made_anew_begins_with_what_was_changed(
    make_live: Callable[..., Any],
) -> None:
    twins: dict[str, Any] = {}
    first = make_live()
    first.store.alarm_overlays.change({("bench-1", NAME): {"setpoint": 60.0}}, LINE, "", 0)
    tuning = AlarmTuning(first.store, twins)
    tuning.read_store()
    for changed in ({}, {"limits": {"t_inner_ring_c": {"warning": 72, "alarm": 90}}}):
        twins["bench-1"] = make_live(asset_section(**changed)).runtime
        tuning.settle(twins["bench-1"])
        assert twins["bench-1"].settings.limits["t_inner_ring_c"].warning == 60
    first.store.alarm_overlays.change({("bench-1", NAME): {}}, LINE, "", 1)
    await tuning.apply_changes()
    limits = twins["bench-1"].settings.limits["t_inner_ring_c"]
    assert (limits.warning, limits.alarm) == (72, 90)


async def test_what_does_not_fit_any_more_leaves_the_limits_of_the_configuration(
    make_live: Callable[..., Any],
) -> None:
    live = make_live()
    live.store.alarm_overlays.change({("bench-1", NAME): {"setpoint": 96.0}}, LINE, "", 0)
    tuning = AlarmTuning(live.store, {"bench-1": live.runtime})
    tuning.read_store()
    tuning.settle(live.runtime)
    assert live.documents.summary().limits["t_inner_ring_c"].warning == 70
