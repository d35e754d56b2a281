from typing import Any

from service.features.drift.documents import DriftSeries

DRIFT = "/api/v1/assets/bench-1/drift"
FOUND = {
    "changed": True,
    "text": "friction moved, friction heat: +18 % (95 %: +9 to +27 %)",
    "point": {"speed_rpm": 3000.0, "load_n": 2700.0, "temperature_c": 50.0},
    "quantities": {
        "friction": {
            "text": "friction heat",
            "group": "friction",
            "unit": "W",
            "value": 78.0,
            "low": 66.0,
            "high": 92.0,
        }
    },
    "comparison": {
        "version": 1,
        "shared": 0.0,
        "alike": "the same run again",
        "statistic": 61.2,
        "dimensions": 9,
        "probability": 8e-10,
        "groups": {"friction": 1.0},
        "moves": [{"quantity": "friction", "text": "…", "change": 0.18, "low": 0.09, "high": 0.27}],
    },
    "sums": {"friction": 6.2},
    "creeping": ["friction"],
}


def _document(drift: Any, hour: int) -> dict[str, Any]:
    return {
        "model": "default",
        "parameters": {
            "M0": {"value": 1.2, "unit": "-", "low": 1.0, "high": 1.4, "verdict": "informed"}
        },
        "windows": [
            {
                "start": "2026-11-20T06:00:00.000Z",
                "end": f"2026-11-20T{hour:02d}:00:00.000Z",
                "speed_rpm_max": 2400.0,
                "load_n_max": 2650.0,
            }
        ],
        "scores": {},
        "naive": {},
        "gates": None,
        "job": None,
        "drift": drift,
    }


async def test_series_shows_identified_versions_oldest_first(world: Any) -> None:
    now_us = world.clock.now_us()
    first = _document(None, 8) | {"windows": []}
    del first["drift"]  # as older releases stored it
    old = _document(None, 9)
    del old["drift"]
    for document in (first, old, _document(FOUND, 10)):
        world.store.models.add("bench-1", "candidate", "", document, now_us)
    answer = await world.client("engineer").get(DRIFT)
    assert answer.status_code == 200
    items = DriftSeries.model_validate(answer.json()).items
    assert [item.version for item in items] == [2, 3]
    assert items[0].changed is None
    assert "before" in items[0].text
    assert items[0].data_end == "2026-11-20T09:00:00.000Z"
    assert items[1].changed is True
    assert items[1].quantities["friction"].high == 92.0
    assert items[1].parameters["M0"].verdict == "informed"
    assert items[1].comparison is not None
    assert items[1].comparison.moves[0].change == 0.18
    last = (await world.client("engineer").get(DRIFT, params={"limit": 1})).json()["items"]
    assert [item["version"] for item in last] == [3]
    shown = (await world.client("engineer").get("/api/v1/assets/bench-1/models/3")).json()
    assert shown["drift"] == FOUND
    shown = (await world.client("engineer").get("/api/v1/assets/bench-1/models/2")).json()
    assert shown["drift"] is None


async def test_series_is_for_engineers_of_known_assets(world: Any) -> None:
    assert (await world.client("viewer").get(DRIFT)).status_code == 403
    unknown = await world.client("engineer").get("/api/v1/assets/bench-9/drift")
    assert unknown.status_code == 404
    assert (await world.client("engineer").get(DRIFT, params={"limit": 0})).status_code == 422
    assert (await world.client("engineer").get(DRIFT)).json() == {"items": [], "next": None}
