"""A newcomer adds a driver (a folder, a line) and an alarm kind (one file); the service runs them.

The packages are copied, changed as CONTRIBUTING.md says, and started as a user would.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from processes import Station, free_port, wait_until

import service

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]

ROOT = Path(service.__file__).parents[1]
PATIENCE_S = 120.0

DRIVER = {
    "__init__.py": '''
"""Fixed values, sent again and again."""

from adapters.drivers.steady.config import SteadyChannel, SteadySource
from adapters.protocol import DriverSpec

STEADY = DriverSpec(
    SteadySource,
    SteadyChannel,
    plan_model=None,
    check_function="adapters.drivers.steady.driver:check",
    driver_class="adapters.drivers.steady.driver:SteadyDriver",
)
''',
    "config.py": '''
"""Configuration models."""

from typing import Literal

from adapters.configuration import MeasuredChannel, SourceConfig


class SteadySource(SourceConfig):
    """Sends every `period_s`."""

    driver: Literal["steady"] = "steady"
    period_s: float = 0.2

    @property
    def expected_period_s(self) -> float:
        """As configured."""
        return self.period_s


class SteadyChannel(MeasuredChannel):
    """A channel of one value."""

    value: float
''',
    "driver.py": '''
"""The driver."""

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Quality, Sample


class SteadyDriver:
    """Sends the configured values."""

    def __init__(self, source, channels, plans, clock):
        self._source, self._channels, self._clock = source, channels, clock
        self._health = SourceHealth(source.name, "steady", up=True, detail="ok")

    @property
    def name(self):
        return self._source.name

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        self._health.up = False

    def health(self):
        return self._health

    async def batches(self):
        while True:
            now_us = self._clock.now_us()
            yield Batch(
                [
                    Sample(one.asset, one.channel, now_us, one.config.value, Quality.GOOD, now_us)
                    for one in self._channels
                ]
            )
            self._health.last_good_us = now_us
            await self._clock.sleep(self._source.period_s)


def check(source, channels, plans):
    """Nothing can be wrong."""
''',
}
REGISTRY_LINE = '    "steady": "adapters.drivers.steady:STEADY",\n'

KIND = '''
"""The rings of a bearing too far apart in temperature."""

from pydantic import Field

from service.domain.alarm_kind import AlarmKind, PlainRule
from service.domain.channels import RING_SENSORS


class Settings(PlainRule):
    """Inner ring minus outer ring."""

    on_delay_s: float = 0.0
    limit_k: float = Field(20.0, gt=0)


def _conditions(context, rule):
    inner_c, outer_c = (context.good_value(name) for name in RING_SENSORS)
    if inner_c is None or outer_c is None:
        return
    apart_k = round(inner_c - outer_c, 3)
    yield KIND.condition(
        context,
        rule,
        RING_SENSORS[0],
        "",
        apart_k >= rule.limit_k,
        f"The rings are {apart_k:g} K apart",
        value=apart_k,
        limit_value=rule.limit_k,
        unit="K",
    )


KIND = AlarmKind("ring difference", Settings, _conditions)
'''

CONFIGURATION = """\
[service]
port = {port}
data_dir = "data"

[[sources]]
name = "hand"
driver = "steady"

[[assets]]
id = "bench-1"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
speed_rpm = {{ source = "hand", value = 1500 }}
load_n = {{ source = "hand", value = 2000 }}
ambient_c = {{ source = "hand", value = 22 }}
t_inner_ring_c = {{ source = "hand", value = 61.5 }}
t_outer_ring_c = {{ source = "hand", value = 31.5 }}
"""


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the import walls of the packages in a folder."""
    command = "import sys; from importlinter.cli import lint_imports_command as lint; lint()"
    return subprocess.run(
        [sys.executable, "-c", command, "--no-cache"],
        cwd=folder,
        env={"PYTHONPATH": str(folder), "PATH": ""},
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """The three packages, of which two may be changed."""
    folder = tmp_path / "packages"
    for name in ("adapters", "service"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "twin_core").symlink_to(ROOT / "twin_core")
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def add_driver(folder: Path) -> None:
    """One folder and one line of the registry."""
    driver = folder / "adapters" / "drivers" / "steady"
    driver.mkdir()
    for name, text in DRIVER.items():
        (driver / name).write_text(text)
    registry = folder / "adapters" / "registry.py"
    text = registry.read_text()
    registry.write_text(text.replace("_SPECS = {\n", f"_SPECS = {{\n{REGISTRY_LINE}", 1))


def add_alarm_kind(folder: Path) -> None:
    """One file."""
    (folder / "service" / "alarm_kinds" / "ring_difference.py").write_text(KIND)


def test_a_new_driver_and_a_new_alarm_kind_run(
    packages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_driver(packages)
    add_alarm_kind(packages)
    port = free_port()
    configuration = tmp_path / "service.toml"
    configuration.write_text(CONFIGURATION.format(port=port))
    monkeypatch.chdir(packages)
    monkeypatch.setenv("PYTHONPATH", str(packages))
    station = Station(tmp_path, configuration, port)
    try:
        station.start_service()

        def raised() -> dict[str, Any] | None:
            alarms = station.get("/api/v1/alarms")["items"]
            return next((one for one in alarms if one["kind"] == "ring difference"), None)

        alarm = wait_until(raised, PATIENCE_S, "an alarm of the new kind")
        assert alarm["message"] == "The rings are 30 K apart"
        assert (alarm["value"], alarm["limit_value"], alarm["unit"]) == (30.0, 20.0, "K")
        assert station.tag("t_inner_ring_c") == 61.5
        [asset] = station.get("/api/v1/assets")["items"]
        [inner] = [one for one in asset["channels"] if one["name"] == "t_inner_ring_c"]
        assert (inner["source"], inner["max_age_s"]) == ("hand", 10.0)
    finally:
        station.close()


def test_the_import_walls_hold_for_a_new_driver_that_nobody_has_listed(packages: Path) -> None:
    add_driver(packages)
    kept = lint(packages)
    assert kept.returncode == 0, kept.stdout + kept.stderr
    driver = packages / "adapters" / "drivers" / "steady" / "driver.py"
    driver.write_text(driver.read_text() + "\nfrom adapters.virtual_bench import find_scenario\n")
    broken = lint(packages)
    assert broken.returncode != 0
    assert "The drivers never lean on the virtual bench BROKEN" in " ".join(broken.stdout.split())
