"""Every route and every kind of message of a real site against what is published of them.

A bench, real wires, a twin that identifies by itself. Answers are held against ``/openapi.json``
and messages against ``/asyncapi.json``, by a validator that is not ours; the schemas forbid
whatever they do not name. A route or a kind of message that nothing here calls up fails the test.
"""

import asyncio
import json
import re
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from typing import Any

import httpx2
import pytest
import websockets
from engineer import go_from_a_run_to_a_forecast
from integration.published import Published
from patience import within
from processes import Site, wait_until

from service.demo.configuration import ASSET
from service.features.commissioning.file_versions import save
from service.features.nights.tables import FleetRun, FleetRuns
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from service.site.settings import load_settings
from service.store.sister_records import SisterRecord

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900)]

A = f"/api/v1/assets/{ASSET}"
ALARMS = "/api/v1/alarms"
PUSHED = "t_node_5_c"
FAMILY = "6311 grease-L"
LATCHED = "\n[assets.alarms.stale_data]\nlatched = true\n"
#: Nobody listens there.
NOTIFICATION = """
[[notifications]]
id = "nobody"
kind = "webhook"
url = "http://127.0.0.1:9/"
only_escalations = true
"""
MESSAGES_S = 400.0
STEP = {"duration_s": 600, "speed_rpm": 4200, "load_n": 2650}
ENDLESS = {"method": "noa", "budget": 5_000_000}
#: An asset that is not in the configuration file.
SPARE = "spare-1"
SPARE_TABLE = {
    "bearing": "6311",
    "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3000},
    "channels": {
        name: {"source": "push"} for name in ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c")
    },
}
#: A caller who may not do what a route does: gateways push and see assets, nothing else.
STRANGERS = ("gateway", "viewer")
LINES = {"Content-Type": "text/plain"}


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Published]:
    with Site(tmp_path_factory.mktemp("site"), "demo", 100.0, pushed=PUSHED) as site:
        text = site.configuration.read_text() + LATCHED + NOTIFICATION
        named = text.replace("[[assets]]\n", f'[[assets]]\nfamily = "{FAMILY}"\n', 1)
        assert named != text
        site.configuration.write_text(named)
        site.start_bench()
        site.start_service()
        site.client.timeout = httpx2.Timeout(240.0)
        yield Published(site, site.get("/openapi.json"), site.get("/asyncapi.json"))


def test_what_answers_before_the_first_identification(published: Published) -> None:
    call = published.call
    call("GET", f"{A}/advice", 409, params={"speed_rpm": 6200, "load_n": 5500})
    for part in ("", "/snapshot", "/state", "/verdict", "/models", "/models/1"):
        call("GET", A + part, 200)
    call("GET", "/livez", 200)
    published.site.client.get("/readyz")


def test_every_kind_of_message_fits(published: Published) -> None:
    site, kinds = published.site, published.asyncapi["components"]["messages"]
    wait_until(lambda: site.tag("model.version") > 1, 600, "a re-identification by itself", 1.0)

    async def listen() -> None:
        address = f"ws://127.0.0.1:{site.port}{published.asyncapi['channels']['stream']['address']}"
        async with (
            websockets.connect(
                address,
                additional_headers={"X-API-Key": site.key},
                max_size=None,
                open_timeout=60,
            ) as stream,
            within(MESSAGES_S),
        ):
            acting = asyncio.create_task(asyncio.to_thread(act_on_jobs_and_alarms, published))
            while not (acting.done() and published.received >= kinds.keys()):
                message = json.loads(await stream.recv())
                assert message["type"] in kinds, message["type"]
                payload = kinds[message["type"]]["payload"]
                published.hold(payload, message, published.asyncapi, message["type"])
                published.received.add(message["type"])
            await acting

    asyncio.run(listen())


def act_on_jobs_and_alarms(published: Published) -> None:
    """Do what the stream tells of, and hold the answers against their schemas."""
    call = published.call
    for running in published.site.get(f"{A}/identifications")["items"]:
        if running["status"] in ("queued", "running"):
            call("DELETE", f"{A}/identifications/{running['id']}", 200)
    job = call("POST", f"{A}/identifications", 202, json=ENDLESS)
    one = f"{A}/identifications/{job['id']}"
    call("POST", f"{A}/identifications", 409, json={"method": "refine"})
    wait_until(lambda: call("GET", one, 200)["convergence"], 120, "progress", 0.5)
    call("GET", f"{A}/identifications", 200)
    call("DELETE", one, 200)
    call("DELETE", one, 200)
    # A channel that is pushed once and then gets nothing is stale: an alarm that stays.
    once = [{"channel": PUSHED, "time": published.site.get(f"{A}/state")["time"], "value": 39.0}]
    call("POST", f"{A}/measurements", 200, json={"samples": once})
    alarm = wait_until(
        lambda: next(
            (alarm for alarm in call("GET", ALARMS, 200)["items"] if alarm["channel"] == PUSHED),
            None,
        ),
        60,
        "the alarm of a channel without data",
    )
    path = f"{ALARMS}/{alarm['id']}"
    call("POST", f"{path}/comment", 200, json={"comment": "a look is taken"})
    call("POST", f"{path}/acknowledge", 200, json={"comment": "seen"})
    call("POST", f"{path}/unshelve", 409)
    call("POST", f"{path}/shelve", 200, json={"duration_s": 600})
    call("POST", f"{path}/unshelve", 200)
    call("POST", f"{path}/out-of-service", 200, json={"comment": "sensor is away"})
    call("POST", f"{path}/return-to-service", 200)
    call("POST", f"{path}/reset", 409)
    call("POST", f"{ALARMS}/acknowledge", 200, json={"ids": [alarm["id"], "nothing"]})
    wait_until(lambda: reset_what_is_gone(published, alarm["id"]), 60, "a reset", 0.5)


def reset_what_is_gone(published: Published, alarm_id: str) -> bool:
    """Push a value, so that the latched alarm is gone, and reset it as soon as that is seen."""
    site, call = published.site, published.call
    value = {"channel": PUSHED, "time": site.get(f"{A}/state")["time"], "value": 39.0}
    call("POST", f"{A}/measurements", 200, json={"samples": [value]})
    state = next(one["state"] for one in site.get(ALARMS)["items"] if one["id"] == alarm_id)
    if state != "LATCH":
        return False
    call("POST", f"{ALARMS}/{alarm_id}/reset", 200)
    return True


def test_the_python_client_goes_from_a_run_to_a_forecast(published: Published) -> None:
    site = published.site
    go_from_a_run_to_a_forecast(f"http://127.0.0.1:{site.port}", site.key, ASSET)


def test_every_other_route_answers_as_published(published: Published) -> None:
    site, call = published.site, published.call
    call("GET", "/api/v1/assets", 200)
    call("GET", "/api/v1/assets", 200, params={"limit": 1})
    call("GET", ALARMS, 200, params={"limit": 1})
    call("GET", "/api/v1/fleet", 200)
    call("GET", "/api/v1/fleet", 200, params={"sort": "id", "attention": "true"})
    call("GET", "/api/v1/fleet/map", 200)
    with site.open_store() as store:
        store.part(FleetRuns).save(a_night())
    (night,) = call("GET", "/api/v1/fleet/nights", 200)["items"]
    assert (night["state"], night["left"]) == ("running", 6)
    for part in ("", "/snapshot", "/state", "/verdict", "/forecast", "/envelope", "/windows"):
        call("GET", A + part, 200)
    call("GET", f"{A}/advice", 200, params={"speed_rpm": 6200, "load_n": 5500})
    call("POST", f"{A}/forecasts", 200, json={"profile": [STEP], "nodes": ["t_node_7_c"]})
    call("POST", f"{A}/forecasts", 200, json={"profile": [STEP | {"ambient_c": 24}]})
    kept = call("POST", f"{A}/forecasts", 200, json={"profile": [STEP], "keep": True})
    assert kept["kept_at"] is not None
    call("GET", f"{A}/forecasts", 200, params={"limit": 3})
    call("GET", f"{A}/forecast-performance", 200)
    one = {"lead_time_s": 300, "risk": "low", "version": 1}
    call("GET", f"{A}/forecast-performance", 200, params=one)
    far = {"profile": [STEP], "nodes": ["t_wall_c"]}
    call("POST", f"{A}/forecasts", 422, json=far)
    now = site.get(f"{A}/state")["time"]
    samples = [
        {"channel": PUSHED, "time": now, "value": 40.0},
        {"channel": "t_wall_c", "time": now, "value": 1.0},
    ]
    call("POST", f"{A}/measurements", 200, json={"samples": samples})
    wired = [{"channel": "speed_rpm", "time": now, "value": 1.0}]
    call("POST", f"{A}/measurements", 409, json={"samples": wired})
    many = [{"asset": ASSET} | sample for sample in [*samples, *wired]]
    call("POST", "/api/v1/measurements", 200, json={"samples": many})
    lines = {"content": f"{ASSET} {samples[0]['channel']}=54", "headers": LINES}
    call("POST", "/api/v1/write", 204, **lines)
    call("POST", "/api/v1/write", 400, **lines | {"content": "a line that is none"})
    call("POST", "/api/v1/write", 422, **lines, params={"precision": "week"})
    for query in ({"limit": 5}, {"limit": 5, "resolution": "1min"}, {"limit": 5, "format": "csv"}):
        call("GET", f"{A}/measurements", 200, params=query)
    call("GET", f"{A}/measurements", 422, params={"channel": "t_wall_c"})
    newest = call("GET", f"{A}/models", 200)["items"][0]["version"]
    call("GET", f"{A}/models/{newest}", 200)
    call("GET", f"{A}/drift", 200)
    machine = dict(Machine("default", named_bearing("6311", {}), None).to_dict())
    sister = SisterRecord("another", FAMILY, machine, 1, 90, 5500.0, 6200.0, {})
    with site.open_store() as store:
        store.sisters.put(sister)
    assert [one["asset"] for one in call("GET", f"{A}/sisters", 200)["items"]] == ["another"]
    call("POST", f"{A}/models/1/activate", 200, json={"comment": "back to the priors"})
    call("GET", f"{A}/models/activations", 200)
    call("POST", f"{A}/grease-renewed", 200, json={"comment": "regreased"})
    change_a_limit(published)
    provision(published)
    commission(published)
    call("GET", f"{ALARMS}/statistics", 200)
    call("GET", f"{ALARMS}/journal", 200)
    call("GET", f"{ALARMS}/journal", 200, params={"format": "csv", "limit": 3})
    look_at_runs(published)
    tell_nobody(published)
    call("GET", "/readyz", 200)
    call("GET", "/metrics", 200)
    call("GET", "/api/v1/stream", 426)
    for role in ("viewer", "gateway"):
        made = call("POST", "/api/v1/keys", 201, json={"role": role, "label": "test"})
        published.keys[role] = made["key"]
    spare = call("POST", "/api/v1/keys", 201, json={"role": "viewer", "label": "spare"})
    call("GET", "/api/v1/keys", 200)
    call("DELETE", f"/api/v1/keys/{spare['id']}", 200)
    mine = next(key["id"] for key in site.get("/api/v1/keys")["items"] if key["role"] == "admin")
    call("DELETE", f"/api/v1/keys/{mine}", 409)
    call("GET", "/api/v1/audit", 200)
    with published.as_role(None) as browser:
        login = {"key": published.keys["viewer"]}
        answer = browser.post("/api/v1/session", json=login)
        published.check("POST", "/api/v1/session", 200, answer)
        answer = browser.get("/api/v1/session", headers={"Sec-Fetch-Site": "same-origin"})
        published.check("GET", "/api/v1/session", 200, answer)
        answer = browser.delete("/api/v1/session", headers={"Sec-Fetch-Site": "same-origin"})
        published.check("DELETE", "/api/v1/session", 204, answer)


def look_at_runs(published: Published) -> None:
    call = published.call
    call("GET", f"{A}/runs/none", 404)
    runs = call("GET", f"{A}/runs", 200)["items"]
    assert runs, "the bench turns"
    run = f"{A}/runs/{runs[0]['id']}"
    call("PATCH", run, 200, json={"name": "first"})
    note = {"time": runs[0]["start"], "text": "noise"}
    made = call("POST", f"{run}/annotations", 201, json=note)
    call("POST", f"{run}/annotations", 422, json=note | {"time": "2020-01-01T00:00:00Z"})
    assert call("GET", run, 200)["annotations"] == [made]
    call("GET", f"{run}/report", 200, params={"format": "csv"})
    call("DELETE", f"{run}/annotations/{made['id']}", 204)
    call("DELETE", f"{run}/annotations/{made['id']}", 404)


def tell_nobody(published: Published) -> None:
    call = published.call
    call("GET", "/api/v1/notifications", 200)
    tried = call("POST", "/api/v1/notifications/nobody:test", 200)
    assert not tried["told"]
    call("POST", "/api/v1/notifications/somebody:test", 404)
    now = datetime.fromisoformat(published.site.get(f"{A}/state")["time"])
    silence = {"ends_at": (now + timedelta(days=1)).isoformat(), "comment": "cleaning"}
    weekly = {"days": ["sat"], "begins": "22:00", "ends": "06:00"}
    made = call("POST", "/api/v1/silences", 201, json=silence | {"weekly": weekly})
    call("POST", "/api/v1/silences", 422, json=silence | {"assets": ["nobody"]})
    call("GET", "/api/v1/silences", 200)
    call("DELETE", f"/api/v1/silences/{made['id']}", 204)
    call("DELETE", f"/api/v1/silences/{made['id']}", 404)
    made = call("POST", "/api/v1/silences", 201, json=silence)
    call("POST", "/api/v1/silences/end", 200, json={"ids": [made["id"], "none"]})
    call("POST", "/api/v1/silences/end", 404, json={"ids": [made["id"]]})


def change_a_limit(published: Published) -> None:
    """A real cell: after the answer the asset, its verdict and the workers know the new limit."""
    call, settings = published.call, "/api/v1/alarm-settings"
    warning = {"asset": ASSET, "tag": "t_inner_ring_c", "kind": "measured limit"}
    warning["level"] = "warning"
    before = call("GET", A, 200)["limits"]["t_inner_ring_c"]["warning"]
    lower = before - 1.5
    change = warning | {"setpoint": lower, "comment": "lower"}
    assert call("PATCH", settings, 200, json=change)["in_effect"]
    assert call("GET", A, 200)["limits"]["t_inner_ring_c"]["warning"] == lower
    limits = call("GET", f"{A}/envelope", 200)["sensors"]["t_inner_ring_c"]["limits"]
    assert limits["warning"]["limit_c"] == lower
    ahead = call("POST", f"{A}/forecasts", 200, json={"profile": [STEP]})
    assert f'"warning":{lower:g}' in json.dumps(ahead).replace(" ", "")
    listed = call("GET", settings, 200, params={"asset": ASSET})["items"]
    shown = [one["setpoint"] for one in listed if warning.items() <= one.items()]
    assert shown == [lower]
    back = {"rows": [warning | {"setpoint": None}], "comment": "back"}
    assert call("POST", f"{settings}/import", 200, json=back)["in_effect"]
    assert call("GET", A, 200)["limits"]["t_inner_ring_c"]["warning"] == before
    call("POST", f"{settings}/import", 422, json=back | {"comment": ""})
    call("PATCH", settings, 422, json=change | {"setpoint": 499.0})
    assert len(call("GET", f"{settings}/history", 200)["items"]) == 2


def a_night() -> FleetRun:
    now_us = time.time_ns() // 1000
    return FleetRun(
        id="run",
        night="2026-11-22",
        chosen="all assets",
        executor="process",
        workers=2,
        workers_lost=0,
        asked=10,
        identified=1,
        warm_starts=1,
        refused=0,
        done_before=0,
        skipped=2,
        without_new_data=1,
        failed=1,
        processor_s=0.4,
        began_us=now_us,
        told_us=now_us,
        ended_us=None,
        problems={ASSET: "3 workers died of it"},
    )


def provision(published: Published) -> None:
    call, spare = published.call, f"/api/v1/assets/{SPARE}"
    call("PUT", spare, 201, json=SPARE_TABLE)
    call("PUT", spare, 200, json=SPARE_TABLE)
    call("GET", f"{spare}/verdict", 200)
    call("PATCH", spare, 200, json={"group": "spare parts"})
    call("DELETE", spare, 204)
    call("PATCH", A, 409, json={"group": "spare parts"})
    only_new = {"If-None-Match": "*"}
    call("PUT", A, 409, json=SPARE_TABLE, headers=only_new)
    listed = [{"id": SPARE} | SPARE_TABLE, {"id": "spare-2"}]
    call("POST", "/api/v1/assets:import", 200, json={"assets": listed}, params={"partial": True})
    call("PUT", spare, 412, json=SPARE_TABLE, headers=only_new)
    call("POST", "/api/v1/assets:remove", 200, json={"ids": [SPARE]})
    call("POST", "/api/v1/assets:remove", 422, json={"ids": [SPARE]})
    call("PUT", spare, 201, json=SPARE_TABLE, headers=only_new)
    call("GET", f"{A}/configuration", 200)
    call("GET", f"{spare}/configuration", 200)
    call("GET", "/api/v1/provisioning", 200)
    call("GET", "/api/v1/provisioning/removed", 200)


def commission(published: Published) -> None:
    """The routes of the page Commissioning, with a change that changes nothing."""
    call, base = published.call, "/api/v1/commissioning"
    known = call("GET", base, 200)
    source = {"name": "strange", "driver": "modbus-tcp", "host": "127.0.0.1", "port": 9}
    call("POST", f"{base}/units", 200, json={"source": source, "count": 1})
    call("POST", f"{base}/registers", 200, json={"source": source, "count": 1})
    dbc = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|9] "" A\n'
    name = call("POST", f"{base}/dbc", 201, json={"name": "strange.dbc", "text": dbc})["name"]
    bus = {"name": "bus", "driver": "can", "channel": "socket://127.0.0.1:9", "dbc": name}
    call("POST", f"{base}/signals", 200, json={"source": bus, "listen_s": 0.1})
    same = {"revision": known["revision"], "assets": known["assets"]}
    assert call("POST", f"{base}/check", 200, json=same)["file"] == known["file"]
    call("PUT", f"{base}/configuration", 409, json=same | {"revision": "old"})
    assert not call("PUT", f"{base}/configuration", 200, json=same)["changed"]
    settings = load_settings(published.site.configuration)
    text = published.site.configuration.read_text(encoding="utf-8")
    more = {"who": "test", "what": "a comment", "now_us": 1}
    version = save(
        published.site.configuration,
        settings.data_dir,
        f"{text}# strange\n",
        based_on=known["revision"],
        **more,
    )
    assert version is not None
    call("GET", f"{base}/versions", 200)
    again = f"{base}/versions/{version.number}/restore"
    assert not call("POST", again, 200, json={"revision": version.revision})["changed"]


def test_every_refusal_is_a_problem_as_published(published: Published) -> None:
    refusals: list[tuple[int, str | None, Callable[[dict[str, Any]], bool]]] = [
        (401, None, lambda operation: bool(operation["security"])),
        *((403, role, refuses(role)) for role in STRANGERS),
    ]
    for status, role, applies in refusals:
        with published.as_role(role) as client:
            for name, operation in published.operations.items():
                method, path = name.split()
                if path == "/metrics" or not applies(operation):
                    continue  # the metrics are free on the machine itself
                address = re.sub(r"\{\w+\}", "1", path.replace("{asset_id}", ASSET))
                answer = client.request(method, address, json=None)
                published.check(method, address, status, answer)
    for name, operation in published.operations.items():
        method, path = name.split()
        here = path.replace("{asset_id}", SPARE if method in ("PUT", "PATCH") else ASSET)
        if "404" in operation["responses"]:
            away = re.sub(r"\{\w+\}", "9999", path)
            published.call(method, away, 404, **fitting(method, path))
        contents = operation.get("requestBody", {}).get("content", {})
        if "application/json" in contents and "422" in operation["responses"]:
            address = re.sub(r"\{\w+\}", "9999", here)
            published.call(method, address, 422, json={"no such member": 1})


def refuses(role: str) -> Callable[[dict[str, Any]], bool]:
    return lambda operation: role not in operation.get("x-roles", [role])


def fitting(method: str, path: str) -> dict[str, Any]:
    """Parameters and a body that pass, so that only the name in the path is wrong."""
    bodies: dict[str, Any] = {
        "forecasts": {"profile": [STEP]},
        "measurements": {"samples": []},
        "identifications": {},
        "shelve": {"duration_s": 60},
        "comment": {"comment": "x"},
        "restore": {"revision": "x"},
        "end": {"ids": ["none"]},
        "out-of-service": {"comment": "x"},
    }
    last = path.rpartition("/")[2]
    if last == "advice":
        return {"params": {"speed_rpm": 6200, "load_n": 5500}}
    if method == "PATCH":
        return {"json": {}}
    return {"json": bodies[last]} if method == "POST" and last in bodies else {}


def test_no_route_and_no_kind_of_message_was_left_out(published: Published) -> None:
    """Runs last: what was called above is all there is."""
    missed = []
    for name, operation in published.operations.items():
        statuses = {status for called, status in published.answered if called == name}
        wanted = {401, 403, 404} & {int(status) for status in operation["responses"]}
        if name.endswith(("/metrics", " /api/v1/session")):
            wanted -= {401, 403}
        everybody = set(STRANGERS) <= set(operation.get("x-roles", STRANGERS))
        missed += [(name, status) for status in wanted - statuses - ({403} if everybody else set())]
        if not any(status < 300 or status == 426 for status in statuses):
            missed.append((name, 200))
    assert not missed
    assert published.received == set(published.asyncapi["components"]["messages"])
