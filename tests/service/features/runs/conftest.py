"""A machine that ran for hours: everything that a report tells of is in the store."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.samples import Sample
from service.alarms import AlarmCondition
from service.alarms.records import normal_alarm
from service.features.ledger.tables import KeptForecasts, Settled
from service.features.runs.runs import Annotation, Runs
from service.site.asset_section import AssetSection
from service.store import AlarmTransition, Store
from service.store.forecast_records import IssuedContent, IssuedForecast, Outcome
from tests.service.store.conftest import postgresql, sqlite_store, store
from tests.service.web.api.conftest import empty_store, patient, settings, world

__all__ = [
    "empty_store",
    "patient",
    "postgresql",
    "settings",
    "sqlite_store",
    "store",
    "world",
]

US = 1_000_000
START_US = 1_709_251_200 * US  # 2024-03-01T00:00:00Z
NOBODY = "operator bt_1a2b3c4d"


def section(nodes: int = 13) -> AssetSection:
    """A bearing with a name that is no formula, and all its nodes measured."""
    source = {"source": "push"}
    names = ["speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c"]
    return AssetSection.model_validate(
        {
            "id": "bench-1",
            "name": "Bench $1$ of hall_2",
            "bearing": "6311",
            "low_risk": {"speed_rpm_max": 4300, "load_n_max": 3400},
            "limits": {
                "t_inner_ring_c": {"warning": 70, "alarm": 80},
                "t_outer_ring_c": {"warning": 65, "alarm": 95},
            },
            "channels": dict.fromkeys(
                [*names, *(f"t_node_{number}_c" for number in range(1, nodes + 1))], source
            ),
        }
    )


def fill(
    store: Store, asset: AssetSection, hours: float, every_s: int = 1, pause_s: int = 900
) -> int:
    """Store a run with standstill before and after; gives its end, µs.

    The inner ring warms to 82 °C and has no good value for five minutes after the first hour.
    """
    length = int(hours * 3600)
    seconds = np.arange(-pause_s, length + pause_s, every_s)
    runs = (seconds >= 0) & (seconds < length)
    share = np.clip(seconds / length, 0, 1)
    warm = np.where(seconds < 0, 0.0, 1 - np.exp(-np.maximum(seconds, 0) / (0.15 * length)))
    rng = np.random.default_rng(7)
    for name in asset.channels:
        noise = rng.normal(0, 0.05, seconds.size)
        if name == "speed_rpm":
            values = np.where(runs, np.where(share < 0.5, 3000.0, 4200.0) + 40 * noise, 0.0)
        elif name == "load_n":
            values = np.where(runs, 2500.0 + 100 * noise, 0.0)
        else:
            rise = {"ambient_c": 1, "t_inner_ring_c": 60, "t_outer_ring_c": 42}.get(name, 30)
            values = 22 + rise * warm + noise
        bad = (name == "t_inner_ring_c") & (seconds >= 3600) & (seconds < 3900)
        store.samples.write(
            [
                Sample(asset.id, name, START_US + int(at) * US, float(value), quality, 0)
                for at, value, quality in zip(
                    seconds, values, np.where(bad, 16, 192).tolist(), strict=True
                )
            ]
        )
    return START_US + length * US


def tell(store: Store, asset: AssetSection, hours: float) -> None:
    """Alarms, forecasts with what came of them, a model, and annotations of that run."""
    length = int(hours * 3600)
    version = store.models.add(asset.id, "candidate", "", {}, START_US - 7200 * US)
    store.models.activate(asset.id, version, "engineer bt_0", "after run-in", START_US - 3600 * US)

    condition = AlarmCondition(
        asset=asset.id, kind="measured limit", channel="t_inner_ring_c", level="warning",
        active=True, value=70.1, message="Inner ring over warning 70 °C", priority=2,
    )  # fmt: skip
    alarm = normal_alarm(condition, START_US)

    def line(event: str, at_s: int, who: str) -> AlarmTransition:
        return AlarmTransition(
            alarm.id, asset.id, "measured limit", "t_inner_ring_c", "warning", START_US + at_s * US,
            "NORM", "UNACK", who, "", 70.1, "Inner ring over warning 70 °C", event, 2,
            peak_value=78.4,
        )  # fmt: skip

    store.alarms.save(
        alarm,
        [
            line("raise", length // 3, "service"),
            line("acknowledge", length // 3 + 90, NOBODY),
            line("return to normal", length - 60, "service"),
        ],
    )
    leads = [1800, 3600]
    made = range(0, length, 600)
    issued = [
        IssuedForecast(
            asset.id, START_US + at * US, version, "period",
            IssuedContent(
                [(7200.0, 3000.0, 2500.0, 22.0)], True, [], ["t_inner_ring_c"], leads,
                [False, False],
                [[_quantiles(at + lead, length)] for lead in leads], {},
            ),
        )
        for at in made
    ]  # fmt: skip
    store.part(KeptForecasts).add(issued)
    store.part(KeptForecasts).settle(
        [
            Settled(
                one.id, one.due_us or 0, None,
                Outcome([["scored"], ["scored"]], [[_inner(one, lead, length)] for lead in leads]),
            )
            for one in store.part(KeptForecasts).since(asset.id, 0)
        ]
    )  # fmt: skip
    for number, text in enumerate(
        ("oil changed to $VG 46$", '=HYPERLINK("x") \u0007 new belt', "y" * 90)
    ):
        at_us = START_US + (number + 1) * length // 4 * US
        store.part(Runs).annotate(Annotation(f"note-{number}", asset.id, at_us, text, NOBODY))


def _course(at: float, length: int) -> float:
    return float(22 + 60 * (1 - np.exp(-at / (0.15 * length))))


def _quantiles(at: int, length: int) -> list[int | None]:
    return [round(100 * (_course(at, length) + off)) for off in (-2.5, -0.8, 0.2, 1.2, 3.0)]


def _inner(one: object, lead: int, length: int) -> float:
    made_us = one.issued.time_us  # type: ignore[attr-defined]
    return _course((made_us - START_US) / US + lead, length)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Store, AssetSection]]:
    """Two hours at a sample every ten seconds."""
    asset = section(nodes=2)
    with Store.open("", Path(tmp_path_factory.mktemp("machine"))) as store:
        fill(store, asset, 2.0, every_s=10)
        tell(store, asset, 2.0)
        yield store, asset
