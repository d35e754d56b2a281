"""What the service asks of its sources does not grow with the square of their number."""

from collections import Counter
from pathlib import Path

import pytest

from adapters.protocol import Driver, SourceHealth
from adapters.samples import Sample
from service.cell.acquisition import Acquisition
from service.clock import ProcessClock
from service.ingest import Spool
from service.site.asset_tables import check_asset
from service.site.settings import load_settings
from service.site.wiring import wire

CHANNELS = (
    *("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c"),
    *(f"t_node_{number}_c" for number in range(1, 14)),
)


def site(folder: Path, count: int) -> str:
    lines = []
    for number in range(count):
        lines += [
            f'[[sources]]\nname = "plc-{number}"\ndriver = "modbus-tcp"\nhost = "127.0.0.1"\n'
            "port = 9\n",
            f'[[assets]]\nid = "a-{number}"\nbearing = "6311"\n'
            "low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }\n[assets.channels]",
            *(
                f'{name} = {{ source = "plc-{number}", register = {register} }}'
                for register, name in enumerate(CHANNELS)
            ),
            "",
        ]
    return "\n".join(lines)


async def test_asking_for_all_channels_asks_each_source_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 50
    (tmp_path / "site.toml").write_text(site(tmp_path, count))
    wiring = wire(load_settings(tmp_path / "site.toml"))
    spool = Spool.open(tmp_path, 16)
    acquisition = Acquisition(wiring, ProcessClock(), spool)
    asked = Counter[str]()
    (kind,) = {type(driver) for driver in acquisition.drivers}
    health = kind.health

    def counting(driver: Driver) -> SourceHealth:
        asked[driver.name] += 1
        return health(driver)

    monkeypatch.setattr(kind, "health", counting)

    def ask_for_all() -> None:
        for asset, channels in wiring.channels.items():
            for channel, facts in channels.items():
                acquisition.problem(facts.source, asset, channel)

    # However slow this machine is: the word of a source holds while all its channels are asked for.
    monkeypatch.setattr("service.cell.acquisition.ASK_AGAIN_S", 3600.0)
    for _ in range(3):
        ask_for_all()
    assert asked == {f"plc-{number}": 1 for number in range(count)}
    monkeypatch.setattr("service.cell.acquisition.ASK_AGAIN_S", -1.0)
    ask_for_all()
    assert asked == {f"plc-{number}": 1 + len(CHANNELS) for number in range(count)}
    spool.close()


async def test_pushes_are_among_the_sources_while_a_clock_of_theirs_is_ahead(
    tmp_path: Path,
) -> None:
    (tmp_path / "site.toml").write_text(site(tmp_path, 1))
    clock = ProcessClock()
    spool = Spool.open(tmp_path, 16)
    acquisition = Acquisition(wire(load_settings(tmp_path / "site.toml")), clock, spool)
    clocks = acquisition.ingest.clocks
    assert [one.name for one in acquisition.health()] == ["plc-0"]
    now_us = clock.now_us()
    ahead = [
        Sample("a-0", name, now_us + round(by_s * 1e6), 1.0, 192, now_us)
        for name, by_s in (("load_n", 279.0), ("ambient_c", 280.0))
    ]
    clocks.put_right(ahead, "push")
    (_, push) = acquisition.health()
    assert (push.name, push.up, push.clocks_ahead_s["a-0/load_n"]) == ("push", True, 279.0)
    assert push.detail == ("a-0/ambient_c and 1 more: the clock of its source is ahead by 280 s")
    clocks.forget("a-0")
    clocks.put_right(ahead, "plc-0")
    assert acquisition.health()[0].detail.endswith("ahead by 280 s")
    assert acquisition.clock_ahead_s("plc-0", "a-0", "load_n") is None, "of what the source says"
    await acquisition.change({"a-0": None})
    assert acquisition.health() == []
    spool.close()


CAN_SITE = """
[[sources]]
name = "drive"
driver = "can"
channel = "socket://127.0.0.1:9"
dbc = "bench.dbc"

[[templates]]
name = "axle"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
[templates.channels]
load_n = { source = "push" }
[templates.channels.speed_rpm]
source = "drive"
message = "DriveStatus"
signal = "Speed"
frame_id_mask = "{mask}"

[[assets]]
id = "first"
template = "axle"
values = { mask = 2047 }
"""
DBC = """VERSION ""
BS_:
BU_: Drive
BO_ 256 DriveStatus: 8 Drive
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" Drive
"""


async def test_channels_that_do_not_go_together_leave_a_source_as_it_is(tmp_path: Path) -> None:
    """Each asset is right by itself; a cell that ended for it would end at each start."""
    (tmp_path / "bench.dbc").write_text(DBC)
    (tmp_path / "site.toml").write_text(CAN_SITE)
    settings = load_settings(tmp_path / "site.toml")
    table = {"template": "axle", "values": {"mask": 255}}
    second = check_asset(settings, "second", table).wiring
    spool = Spool.open(tmp_path, 16)
    acquisition = Acquisition(wire(settings), ProcessClock(), spool)
    (before,) = acquisition.drivers
    await acquisition.change({"second": second})
    assert acquisition.drivers == [before]
    assert "frame_id_mask 0xff differs from 0x7ff" in acquisition.refused["drive"]
    await acquisition.change({"second": None})
    assert acquisition.refused == {}
    assert acquisition.drivers == [before]
    again = Acquisition(wire(settings), ProcessClock(), spool, {"second": second})
    assert [driver.name for driver in again.drivers] == ["drive"], "nor does a start end for it"
    assert "frame_id_mask" in again.refused["drive"]
    spool.close()
