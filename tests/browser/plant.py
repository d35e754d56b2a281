"""A service whose machines are played by the test: what they measure is pushed over HTTP."""

import threading
import time as wall
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2

from service.clock import ProcessClock, rfc3339
from service.jobs.models import first_model
from service.site.settings import load_settings
from tests.processes import Station, wait_until
from tests.receivers import running_hook
from tests.site_files import COLUMNS, UNCHECKED, asset_text, pushed, write_site
from twin_core.identification.posterior import Posterior
from twin_core.operating_points import OperatingSpan

RATE = 60.0
PUSH_EVERY_S = 0.25
GOOD, BAD = 192, 16
AWAY = 503  # what the web side says of a cell that does not answer
BEARING, GEARBOX = "press-1", "gear-1"
RINGS = ("t_inner_ring_c", "t_outer_ring_c")
LONG_NAME = "Durability bench of the second test field, left spindle"
FLEET_GROUPS = ("Durability", "Acoustics")
_NETWORK = Path(__file__).parents[2] / "deploy/networks/gearbox.toml"
_PUSHED = {
    BEARING: (*RINGS, *COLUMNS),
    GEARBOX: ("t_bearing_c", "t_wall_c", *COLUMNS),
}
_CALM = {
    "t_inner_ring_c": 42.0,
    "t_outer_ring_c": 33.0,
    "t_bearing_c": 40.0,
    "t_wall_c": 31.0,
    "ambient_c": 22.0,
    "speed_rpm": 900.0,
    "load_n": 1200.0,
}
_CLOCK = "[clock]\nrate = {rate}\n"
_HOOK = """
[[notifications]]
id = "control-room"
kind = "webhook"
url = "{hook}"
priorities = [1]
"""
_RING_LIMITS = "limits = { t_inner_ring_c = { warning = 70, alarm = 95 } }"
_BEARING_LIMITS = "limits = { t_bearing_c = { warning = 85, alarm = 95 } }"


class Plant(Station):
    """Two machines, a bearing and a gearbox, that measure whatever the test says.

    Attributes
    ----------
    values
        Present value of every channel, by asset; a test changes them.
    silent
        Assets that send nothing.
    bad
        Channels that send no usable value, whatever the asset.
    hook
        Where alarms of priority 1 are told.
    """

    rate = RATE
    push_every_s = PUSH_EVERY_S

    def __init__(self, folder: Path, pushed: Mapping[str, Sequence[str]] = _PUSHED) -> None:
        self._closing = ExitStack()
        self.hook = self._closing.enter_context(running_hook())
        super().__init__(folder, *write_site(folder, self.configure()))
        self.values = {asset: {n: _CALM[n] for n in names} for asset, names in pushed.items()}
        self.silent: set[str] = set()
        self.bad: set[str] = set()
        self._stop = threading.Event()
        self._pusher = threading.Thread(target=self._push_on)

    def configure(self) -> str:
        """Text of the configuration file, without the service's section."""
        # A test lets temperatures jump and stand still, which no machine does.
        bearing, gearbox = (pushed(names, UNCHECKED) for names in _PUSHED.values())
        return (
            _CLOCK.format(rate=self.rate)
            + _HOOK.format(hook=self.hook.url)
            + asset_text(BEARING, bearing, 'network = "bearing-14"', _RING_LIMITS)
            + asset_text(
                GEARBOX,
                gearbox,
                _BEARING_LIMITS,
                machine=f'network = "{_NETWORK}"',
                low_risk=(1500, 3000),
            )
        )

    def start(self) -> None:
        if BEARING in self.values:
            self.identify(BEARING)
        self.start_service()
        self.clock = ProcessClock.resume(self.rate, load_settings(self.configuration).data_dir)
        self._pusher.start()
        wait_until(self.ready, 120, "every machine to be followed")

    def ready(self) -> bool:
        """Whether there is a forecast of every machine."""
        return all(
            self.client.get(f"/api/v1/assets/{asset}/forecast").is_success for asset in self.values
        )

    def identify(self, asset: str) -> None:
        """Let the service begin with a model that counts as identified, with the prior's spread."""
        assets = load_settings(self.configuration).assets
        section = next(one for one in assets if one.id == asset)
        document = first_model(section)
        posterior = Posterior.from_dict(document["posterior"])
        point = OperatingSpan(4200.0, 3300.0, 7200.0, 0.0)
        trained = replace(posterior.trained, operating_points=(point,), minutes=240)
        document["posterior"] = replace(posterior, trained=trained).to_dict()
        now_us = wall.time_ns() // 1000
        with self.open_store() as store:
            version = store.models.add(asset, "candidate", "", document, now_us)
            store.models.activate(asset, version, "test", "", now_us)

    def offer(self, asset: str, samples: list[dict[str, Any]]) -> httpx2.Response:
        return self.client.post(f"/api/v1/assets/{asset}/measurements", json={"samples": samples})

    def push_all(self, asset: str, samples: list[dict[str, Any]]) -> None:
        answer = self.offer(asset, samples)
        assert answer.is_success, answer.text

    def get(self, path: str, **query: Any) -> Any:
        return super().get(f"/api/v1{path}", **query)

    def alarm(self, kind: str, asset: str = BEARING) -> Any:
        """The open alarm of a kind, None when there is none."""
        alarms = self.get("/alarms", asset=asset)["items"]
        return next((alarm for alarm in alarms if alarm["kind"] == kind), None)

    def calm(self) -> None:
        """Everything measured is harmless again."""
        for values in self.values.values():
            values.update({name: _CALM[name] for name in values})
        self.silent.clear()
        self.bad.clear()

    def _push_on(self) -> None:
        while not self._stop.wait(self.push_every_s):
            time = rfc3339(self.clock.now_us())
            for asset, values in self.values.items():
                if asset in self.silent:
                    continue
                samples = [
                    {
                        "channel": n,
                        "time": time,
                        "value": v,
                        "quality": BAD if n in self.bad else GOOD,
                    }
                    for n, v in values.items()
                ]
                try:
                    answer = self.offer(asset, samples)
                except httpx2.HTTPError:
                    continue  # the service is being started anew
                if answer.status_code != AWAY:  # a test may have stopped the cell
                    assert answer.is_success, answer.text

    def close(self) -> None:
        self._stop.set()
        if self._pusher.ident is not None:
            self._pusher.join()
        super().close()
        self._closing.close()


class Fleet(Plant):
    """Many bearings in two groups, the first with a long name; in real time, as they are many."""

    rate = 1.0
    push_every_s = 1.0

    def __init__(self, folder: Path, count: int) -> None:
        self.ids = [f"bench-{number:02d}" for number in range(1, count + 1)]
        super().__init__(folder, dict.fromkeys(self.ids, _PUSHED[BEARING]))

    def configure(self) -> str:
        channels = pushed(_PUSHED[BEARING], UNCHECKED)
        return _CLOCK.format(rate=self.rate) + "".join(
            asset_text(
                asset,
                channels,
                f'name = "{LONG_NAME if asset == self.ids[0] else asset.capitalize()}"',
                f'group = "{FLEET_GROUPS[number % 2]}"',
                _RING_LIMITS,
            )
            for number, asset in enumerate(self.ids)
        )

    def ready(self) -> bool:
        """Whether every machine is measured; forecasts may still be on their way."""
        return all(
            self.get(f"/assets/{asset}/snapshot")["tags"]["t_inner_ring_c"]["quality"] >= 192
            for asset in self.values
        )
