import asyncio
import contextlib
import csv
import io
import json
import sqlite3
from typing import Any

import pytest

from service.alarms import AlarmCondition
from service.clock import rfc3339
from service.documents.alarms import (
    AcknowledgedAlarms,
    AlarmDocument,
    AlarmJournalList,
    AlarmList,
    AlarmStatistics,
)
from service.pauses import MeasuredCoroutine

ALARMS = "/api/v1/alarms"


async def listed(world: Any, **query: Any) -> list[AlarmDocument]:
    response = await world.client("viewer").get(ALARMS, params=query)
    assert response.status_code == 200
    return AlarmList.model_validate(response.json()).items


async def acknowledge(world: Any, alarm_id: str, body: Any = None) -> Any:
    options = {} if body is None else {"json": body}
    return await world.client("operator").post(f"{ALARMS}/{alarm_id}/acknowledge", **options)


async def test_alarms_are_listed_with_filters(world: Any) -> None:
    standing = world.raise_alarm("t_inner_ring_c")
    acknowledged = world.raise_alarm("t_outer_ring_c")
    returned = world.raise_alarm("t_node_3_c")
    await acknowledge(world, acknowledged)
    world.raise_alarm("t_node_3_c", active=False)

    async def ids(**query: Any) -> set[str]:
        return {alarm.id for alarm in await listed(world, **query)}

    assert await ids() == {standing, acknowledged, returned}
    assert await ids(active="true") == {standing, acknowledged}
    assert await ids(active="false") == {returned}
    assert await ids(unacknowledged="true") == {standing, returned}
    assert await ids(asset="rig-2") == set()
    assert await ids(asset="bench-1", unacknowledged="false") == {acknowledged}


async def test_acknowledging_says_who_and_why(world: Any) -> None:
    alarm_id = world.raise_alarm()
    response = await acknowledge(world, alarm_id, {"comment": "load is being reduced"})
    assert AlarmDocument.model_validate(response.json()).state == "ACKED"
    journal = (await world.client("viewer").get(f"{ALARMS}/journal")).json()
    line = AlarmJournalList.model_validate(journal).items[0]
    assert line.alarm_id == alarm_id
    assert line.who == f"operator {world.keys['operator'][:11]}"
    assert line.comment == "load is being reduced"


async def test_acknowledging_is_told_on_the_stream(world: Any) -> None:
    alarm_id = world.raise_alarm()
    subscription = world.bus.subscribe()
    await acknowledge(world, alarm_id)
    assert '"state":"ACKED"' in (await subscription.get()).text


async def test_acknowledging_twice_is_a_conflict(world: Any) -> None:
    alarm_id = world.raise_alarm()
    await acknowledge(world, alarm_id)
    response = await acknowledge(world, alarm_id)
    assert response.status_code == 409
    assert "is ACKED (acknowledged by operator" in response.json()["detail"]


async def test_returned_alarm_is_over_once_acknowledged(world: Any) -> None:
    alarm_id = world.raise_alarm()
    world.raise_alarm(active=False)
    response = await acknowledge(world, alarm_id)
    assert response.json()["state"] == "NORM"
    assert await listed(world) == []
    assert (await acknowledge(world, alarm_id)).status_code == 404


async def test_unknown_alarm_and_unknown_word_are_refused(world: Any) -> None:
    assert (await acknowledge(world, "none")).status_code == 404
    alarm_id = world.raise_alarm()
    response = await acknowledge(world, alarm_id, {"coment": "typo"})
    assert response.status_code == 422
    assert (await acknowledge(world, alarm_id, {"comment": "x" * 501})).status_code == 422


async def test_journal_comes_newest_first_in_pages(world: Any) -> None:
    for number in range(1, 6):
        world.raise_alarm(f"t_node_{number}_c")
    client = world.client("viewer")
    channels: list[str] = []
    response = await client.get(f"{ALARMS}/journal", params={"limit": 2})
    while True:
        page = AlarmJournalList.model_validate(response.json())
        channels += [str(line.channel) for line in page.items]
        if page.next is None:
            break
        response = await client.get(response.links["next"]["url"])
    assert channels == [f"t_node_{number}_c" for number in (5, 4, 3, 2, 1)]


async def test_each_line_of_the_journal_has_the_unit_of_its_alarm(world: Any) -> None:
    for channel, unit in (("t_inner_ring_c", "°C"), ("t_outer_ring_c", "K"), ("load_n", None)):
        hot = AlarmCondition("bench-1", "deviation", channel, "", True, 15.5, "over", 2, unit=unit)
        world.alarms.evaluate(hot)
    answer = (await world.client("viewer").get(f"{ALARMS}/journal")).json()
    units = {line["channel"]: line["unit"] for line in answer["items"]}
    assert units == {"t_inner_ring_c": "°C", "t_outer_ring_c": "K", "load_n": None}


async def test_journal_can_be_limited_in_time(world: Any) -> None:
    world.raise_alarm()
    client = world.client("viewer")
    now_us = world.clock.now_us()
    before = await client.get(f"{ALARMS}/journal", params={"end": rfc3339(now_us - 60_000_000)})
    assert before.json()["items"] == []
    since = await client.get(f"{ALARMS}/journal", params={"start": rfc3339(now_us - 60_000_000)})
    assert len(since.json()["items"]) == 1
    wrong = await client.get(
        f"{ALARMS}/journal", params={"start": rfc3339(now_us), "end": rfc3339(now_us)}
    )
    assert wrong.json()["errors"][0]["parameter"] == "end"


async def say(
    world: Any, alarm_id: str, what: str, body: Any = None, role: str = "operator"
) -> Any:
    options = {} if body is None else {"json": body}
    return await world.client(role).post(f"{ALARMS}/{alarm_id}/{what}", **options)


async def test_shelving_needs_a_duration_and_is_told_on_the_stream(world: Any) -> None:
    alarm_id = world.raise_alarm()
    for body in ({}, {"duration_s": 0}, {"duration_s": 28_801}, {"duration_s": "60"}):
        refused = await say(world, alarm_id, "shelve", body)
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["pointer"] == "/duration_s"
    subscription = world.bus.subscribe()
    response = await say(world, alarm_id, "shelve", {"duration_s": 60, "comment": "service"})
    shelved = AlarmDocument.model_validate(response.json())
    assert (shelved.state, shelved.comment) == ("SHLVD", "service")
    assert shelved.shelved_by == f"operator {world.keys['operator'][:11]}"
    assert shelved.shelved_until is not None
    told = json.loads((await subscription.get()).text)["data"]
    assert told == response.json()
    assert [alarm.id for alarm in await listed(world, state="SHLVD")] == [alarm_id]
    assert await listed(world, active="true") == []
    assert (await say(world, alarm_id, "unshelve")).json()["state"] == "UNACK"
    assert (await say(world, alarm_id, "unshelve")).status_code == 409


async def test_out_of_service_is_the_engineers_and_needs_a_reason(world: Any) -> None:
    alarm_id = world.raise_alarm()
    why = {"comment": "sensor is on order"}
    assert (await say(world, alarm_id, "out-of-service", why)).status_code == 403
    assert (await say(world, alarm_id, "out-of-service", role="engineer")).status_code == 422
    out = await say(world, alarm_id, "out-of-service", why, "engineer")
    assert (out.json()["state"], out.json()["comment"]) == ("OOSRV", "sensor is on order")
    assert (await say(world, alarm_id, "shelve", {"duration_s": 60})).status_code == 409
    assert (await say(world, alarm_id, "return-to-service")).status_code == 403
    back = await say(world, alarm_id, "return-to-service", role="engineer")
    assert back.json()["state"] == "UNACK"


async def test_a_latched_alarm_is_reset_and_comments_are_kept(world: Any) -> None:
    alarm_id = world.raise_alarm(latched=True)
    assert (await say(world, alarm_id, "comment", {"comment": ""})).status_code == 422
    commented = await say(world, alarm_id, "comment", {"comment": "fan is dirty"})
    assert commented.json()["comment"] == "fan is dirty"
    await acknowledge(world, alarm_id)
    assert (await say(world, alarm_id, "reset")).status_code == 409
    world.raise_alarm(active=False, latched=True)
    (waiting,) = await listed(world, state="LATCH")
    assert waiting.latched
    assert (await say(world, alarm_id, "reset")).json()["state"] == "NORM"
    assert (await say(world, "none", "reset")).status_code == 404


async def test_several_are_acknowledged_at_once(world: Any) -> None:
    ids = [world.raise_alarm(f"t_node_{number}_c") for number in (1, 2, 3)]
    await acknowledge(world, ids[1])
    client = world.client("operator")
    body = {"ids": [*ids, "none", ids[0]], "comment": "all seen"}
    response = await client.post(f"{ALARMS}/acknowledge", json=body)
    answer = AcknowledgedAlarms.model_validate(response.json())
    assert {alarm.id for alarm in answer.items} == {ids[0], ids[2]}
    assert [(one.id, one.detail[:8]) for one in answer.failed] == [
        (ids[1], f"alarm {ids[1]}"[:8]),
        ("none", "no open "),
    ]
    for wrong in ({"ids": []}, {"ids": ["x"] * 501}, {"ids": [1]}, {}):
        assert (await client.post(f"{ALARMS}/acknowledge", json=wrong)).status_code == 422


async def test_what_is_watched_and_normal_is_listed_on_request(world: Any) -> None:
    world.raise_alarm()
    world.raise_alarm("t_node_1_c", active=False)
    assert [alarm.channel for alarm in await listed(world)] == ["t_inner_ring_c"]
    (normal,) = await listed(world, state="NORM")
    assert (normal.channel, normal.raised_at) == ("t_node_1_c", None)
    both = await listed(world, state=["NORM", "UNACK"])
    assert {alarm.state for alarm in both} == {"NORM", "UNACK"}
    wrong = await world.client("viewer").get(ALARMS, params={"state": "GONE"})
    assert wrong.status_code == 422


async def test_the_journal_is_filtered_and_exported(world: Any) -> None:
    first = world.raise_alarm("t_node_1_c")
    world.raise_alarm("t_node_2_c")
    await acknowledge(world, first, {"comment": 'he said "why, now?"'})
    world.alarms.record_event("bench-1", "model drift", "friction rose by 8 %")
    client = world.client("viewer")

    async def lines(**query: Any) -> list[Any]:
        response = await client.get(f"{ALARMS}/journal", params=query)
        assert response.status_code == 200
        items: list[Any] = response.json()["items"]
        return items

    assert [line["event"] for line in await lines(alarm=first)] == ["acknowledge", "raise"]
    (event,) = await lines(**{"class": "event"})
    assert (event["kind"], event["alarm_id"], event["class"]) == ("model drift", None, "event")
    assert len(await lines(**{"class": "alarm", "asset": "bench-1"})) == 3
    assert await lines(asset="rig-2") == []
    whole = await client.get(f"{ALARMS}/journal", params={"format": "csv"})
    assert whole.headers["Content-Type"].startswith("text/csv")
    assert "alarm-journal.csv" in whole.headers["Content-Disposition"]
    rows = list(csv.DictReader(io.StringIO(whole.text)))
    assert [row["class"] for row in rows] == ["event", "alarm", "alarm", "alarm"]
    assert rows[1]["comment"] == 'he said "why, now?"'
    assert rows[1]["peak_value"] == "91.0"
    assert rows[1]["peak_time"] == rows[-1]["time"]
    part = await client.get(f"{ALARMS}/journal", params={"format": "csv", "limit": 1})
    assert len(part.text.splitlines()) == 2
    assert "next" in part.links


async def test_statistics_count_what_called_for_an_operator(world: Any) -> None:
    for number in range(1, 12):
        world.raise_alarm(f"t_node_{number}_c")
    assert world.context.outbox.flush(30.0)
    answer = (await world.client("viewer").get(f"{ALARMS}/statistics")).json()
    statistics = AlarmStatistics.model_validate(answer)
    assert (statistics.last_10_min, statistics.flood) == (11, True)
    assert statistics.per_10_min_average_24h == round(11 / 144, 4)
    assert statistics.most_frequent[0].kind == "measured limit"
    assert statistics.by_priority_24h == {"1": 0, "2": 11, "3": 0}
    assert statistics.stale_over_24h == 0
    calm = (await world.client("viewer").get(f"{ALARMS}/statistics?asset=rig-2")).json()
    assert (calm["last_10_min"], calm["flood"], calm["most_frequent"]) == (0, False, [])


@pytest.mark.parametrize("char", ["\x1b", "\n", "\u2028", "\u202e"])
async def test_a_comment_is_one_line_of_visible_characters(world: Any, char: str) -> None:
    alarm = world.raise_alarm()
    client = world.client("operator")
    said = {"comment": f"a{char}b"}
    for action, body in (
        (f"{alarm}/comment", said),
        (f"{alarm}/acknowledge", said),
        (f"{alarm}/shelve", said | {"duration_s": 60}),
        ("acknowledge", said | {"ids": [alarm]}),
    ):
        answer = await client.post(f"{ALARMS}/{action}", json=body)
        assert answer.status_code == 422, answer.text
        (error,) = answer.json()["errors"]
        assert error["pointer"] == "/comment"
        assert error["detail"] == (
            f"expected one line of text, without control characters (got {f'a{char}b'!r})"
        )


async def test_no_comment_is_a_formula_in_the_journals_csv(world: Any) -> None:
    comments = ['=HYPERLINK("http://evil.example")', "+1+cmd", "-2+3", "@SUM(A1)", "=1+1", "-5"]
    client = world.client("operator")
    alarm = world.raise_alarm()
    for comment in comments:
        answer = await client.post(f"{ALARMS}/{alarm}/comment", json={"comment": comment})
        assert answer.status_code == 200, answer.text
    # Stored before such texts were refused.
    world.alarms.comment(alarm, "operator", "a\x1b[31m;=1")
    answer = await client.get(f"{ALARMS}/journal", params={"format": "csv"})
    rows = csv.DictReader(io.StringIO(answer.text))
    found = [row["comment"] for row in rows if row["comment"]]
    assert found[::-1] == [f"'{comment}" for comment in comments[:-1]] + ["-5", "a [31m;'=1"]


async def test_an_action_that_nothing_keeps_is_not_answered_as_done(world: Any) -> None:
    alarm = world.raise_alarm()
    assert world.context.outbox.flush(30.0)
    with contextlib.ExitStack() as stack:
        for name in ("outbox.db", "bearing-twin.db"):  # other programs hold both
            path = world.data_dir / name
            other = stack.enter_context(contextlib.closing(sqlite3.connect(path)))
            other.execute("BEGIN EXCLUSIVE")
        answer = await acknowledge(world, alarm)
        assert answer.status_code == 503, answer.text
        assert "neither the store nor the disk takes it" in answer.json()["detail"]
        other.close()
    assert world.context.outbox.flush(30.0)
    (found,) = await listed(world)
    assert found.state == "ACKED"


async def test_alarms_come_in_pages_of_the_same_order(world: Any) -> None:
    channels = [f"t_node_{number}_c" for number in range(1, 8)]
    raised = [world.raise_alarm(channel) for channel in channels]
    await acknowledge(world, raised[2])
    for query in ({}, {"unacknowledged": "true"}, {"state": ["UNACK", "NORM", "ACKED"]}):
        whole = [alarm.id for alarm in await listed(world, **query)]
        assert len(whole) >= 6
        found: list[str] = []
        more: dict[str, str] = {}
        while True:
            answer = await world.client("viewer").get(ALARMS, params={"limit": 2} | query | more)
            page = AlarmList.model_validate(answer.json())
            found += [alarm.id for alarm in page.items]
            assert len(page.items) == 2 or page.next is None
            assert ("link" in answer.headers) == (page.next is not None)
            if page.next is None:
                break
            more = {"cursor": page.next}
        assert found == whole
    for wrong in ({"cursor": more["cursor"]}, {"limit": 2, "cursor": "x"}, {"limit": 0}):
        assert (await world.client("viewer").get(ALARMS, params=wrong)).status_code == 422


#: Mean processor time between two pauses that is too long; a pause is due after a tenth of it.
_STEP_S = 0.005


async def test_a_poll_comes_in_between_however_many_alarms_a_caller_asks_for(world: Any) -> None:
    world.alarms.evaluate_all(
        AlarmCondition(
            asset=f"bench-{number % 10}",
            kind="measured limit",
            channel=f"t_node_{number}_c",
            level="warning",
            active=number % 2 == 0,
            value=91.0,
            message="over its warning limit",
            priority=2,
        )
        for number in range(2000)
    )
    ids = [alarm.id for alarm in world.alarms.active()]
    for work in (
        world.alarm_answers.listed(),
        world.alarm_answers.listed(normal=True),
        world.alarm_answers.acknowledge(ids[:500], "eva", ""),
        world.alarm_answers.acknowledge(ids[:500], "eva", ""),  # refused
    ):
        steps_s: list[float] = []
        await asyncio.create_task(MeasuredCoroutine(work, steps_s.append))
        # In one go it would be two: one of the work, and one behind the wait for the disk.
        assert len(steps_s) > 1 + sum(steps_s) / _STEP_S, steps_s
    assert sum(one.state == "ACKED" for one in world.alarms.active()) == 500
