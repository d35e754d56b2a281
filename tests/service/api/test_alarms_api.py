from typing import Any

from service.api.bodies import AlarmDocument, AlarmJournalList, AlarmList
from service.clock import rfc3339

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
    assert "acknowledged already by operator" in response.json()["detail"]


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
