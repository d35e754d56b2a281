"""A newcomer adds a driver, an alarm kind, channels and a feature; the service runs them.

The packages are copied, changed as CONTRIBUTING.md says, and started as a user would.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from patience import patience
from processes import Station, wait_until
from site_files import asset_text, write_site

import service
from service.demo.configuration import ASSET
from service.store import Store
from service.store.migrations import last_revision

from .newcomer import DRIVER, FEATURE, MIGRATION

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]

ROOT = Path(service.__file__).parents[1]
PATIENCE_S = 120.0

REGISTRY_LINE = '    "steady": "adapters.drivers.steady:STEADY",\n'

#: The test and the alarm kind that the page of the first change prints, by the file it names.
_PAGE = (ROOT / "docs" / "develop" / "first-change.md").read_text()
FIRST_CHANGE = dict(re.findall(r"Save this as `([^`]+)`.*?```python\n(.*?)```", _PAGE, re.DOTALL))
KIND_FILE = "service/alarm_kinds/ring_difference.py"
TEST_FILE = "tests/service/alarms/test_ring_difference.py"

#: One channel of each part, each with a unit of its own.
CHANNELS = """\
    Channel("torque_nm", "Torque", "Nm", "operation"),
    Channel("t_cage_c", "Cage", "°C", "ring", limits_c=(95, 110)),
    Channel("oil_pressure_bar", "Oil pressure", "bar", "controller"),
"""

SOURCE = '[[sources]]\nname = "hand"\ndriver = "steady"\n'
VALUES = {
    "speed_rpm": 1500,
    "load_n": 2000,
    "ambient_c": 22,
    "t_inner_ring_c": 61.5,
    "t_outer_ring_c": 31.5,
    "torque_nm": 12.5,
    "t_cage_c": 44,
}
BY_HAND = '{name} = {{ source = "hand", value = {value} }}\n'


class ChangedStation(Station):
    """A service of the changed packages: this process cannot read its configuration."""

    def open_store(self) -> Store:
        return Store.open("", self.folder / "data")


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
        timeout=patience(280),
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


def add(folder: Path, file: str) -> None:
    """One file of the first change, as the page prints it."""
    (folder / file).parent.mkdir(parents=True, exist_ok=True)
    (folder / file).write_text(FIRST_CHANGE[file])


def test_the_first_change_is_as_its_page_says(packages: Path) -> None:
    def tried() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", TEST_FILE],
            cwd=packages,
            env=os.environ | {"PYTHONPATH": str(packages)},
            capture_output=True,
            text=True,
            check=False,
            timeout=patience(240),
        )

    add(packages, TEST_FILE)
    without = tried()
    assert without.returncode != 0
    assert "No module named 'service.alarm_kinds.ring_difference'" in without.stdout
    add(packages, KIND_FILE)
    kept = tried()
    assert kept.returncode == 0, kept.stdout + kept.stderr
    assert "3 passed" in kept.stdout


def add_channels(folder: Path) -> None:
    """A row for each."""
    file = folder / "service" / "domain" / "channels.py"
    text = file.read_text()
    assert text.count("STANDARD = (\n") == 1
    file.write_text(text.replace("STANDARD = (\n", f"STANDARD = (\n{CHANNELS}"))


def add_feature(folder: Path) -> None:
    """One folder."""
    feature = folder / "service" / "features" / "shift_notes"
    (feature / "migrations").mkdir(parents=True)
    for name, text in FEATURE.items():
        (feature / name).write_text(text)
    before = last_revision()
    revision = f"{int(before) + 1:04d}"
    migration = MIGRATION.format(revision=revision, before=before)
    (feature / "migrations" / f"{revision}_shift_notes.py").write_text(migration)


@pytest.mark.thorough
def test_what_a_newcomer_adds_runs(
    packages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The store is one that was made before the feature came.
    with Store.open("", tmp_path / "data"):
        pass
    add_driver(packages)
    add(packages, KIND_FILE)
    add_channels(packages)
    add_feature(packages)
    channels = "".join(BY_HAND.format(name=n, value=v) for n, v in VALUES.items())
    controller = "[assets.controller]\n" + BY_HAND.format(name="oil_pressure_bar", value=3.5)
    text = SOURCE + asset_text(ASSET, channels + controller)
    monkeypatch.chdir(packages)
    monkeypatch.setenv("PYTHONPATH", str(packages))
    with ChangedStation(tmp_path, *write_site(tmp_path, text)) as station:
        station.start_service()

        def raised() -> dict[str, Any] | None:
            alarms = station.get("/api/v1/alarms")["items"]
            return next((one for one in alarms if one["kind"] == "ring difference"), None)

        alarm = wait_until(raised, PATIENCE_S, "an alarm of the new kind")
        assert f"    {alarm['message']}\n" in _PAGE, "what the page shows"
        assert (alarm["value"], alarm["limit_value"], alarm["unit"]) == (30.0, 15.0, "K")
        assert station.tag("t_inner_ring_c") == 61.5
        [asset] = station.get("/api/v1/assets")["items"]
        [inner] = [one for one in asset["channels"] if one["name"] == "t_inner_ring_c"]
        assert (inner["source"], inner["max_age_s"]) == ("hand", 10.0)
        units = {one["name"]: one["unit"] for one in asset["channels"]}
        assert units["torque_nm"] == "Nm"
        assert units["oil_pressure_bar"] == "bar"
        assert units["t_cage_c"] == "°C"
        assert station.tag("torque_nm") == 12.5
        assert station.tag("oil_pressure_bar") == 3.5
        assert station.get("/api/v1/shift-notes") == []
        made = station.client.post("/api/v1/shift-notes", json={"text": "the fan is loud"})
        assert made.status_code == 204, made.text
        assert station.get("/api/v1/shift-notes") == ["the fan is loud"]
        heading = station.client.get("/api/v1/shift-notes/heading", params={"name": "night"})
        assert heading.json() == "night: bench-1", "as the feature's part of the cell answers"
        checks = {one["name"]: one for one in station.get("/readyz")["checks"]}
        assert checks["shift notes"]["status"] == "degraded"
        actions = [one["action"] for one in station.get("/api/v1/audit")["items"]]
        assert "note.make" in actions


def test_the_import_walls_hold_for_a_new_driver_that_nobody_has_listed(packages: Path) -> None:
    add_driver(packages)
    kept = lint(packages)
    assert kept.returncode == 0, kept.stdout + kept.stderr
    driver = packages / "adapters" / "drivers" / "steady" / "driver.py"
    driver.write_text(driver.read_text() + "\nfrom adapters.virtual_bench import find_scenario\n")
    broken = lint(packages)
    assert broken.returncode != 0
    assert "The drivers never lean on the virtual bench BROKEN" in " ".join(broken.stdout.split())


def test_a_feature_brings_its_command_and_what_check_warns_of(
    packages: Path, tmp_path: Path
) -> None:
    add_feature(packages)
    environment = {"PYTHONPATH": str(packages), "PATH": ""}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "service", *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )

    assert run("shift").stdout == "notes of a shift\n"
    (tmp_path / "site.toml").write_text("[service]\ndata_dir = 'data'\n")
    assert "nobody is on shift" in run("check", "-c", "site.toml").stderr


def test_a_feature_imports_no_other_and_the_core_imports_none(packages: Path) -> None:
    add_feature(packages)
    kept = lint(packages)
    assert kept.returncode == 0, kept.stdout + kept.stderr
    (packages / "service" / "features" / "shift_notes" / "health.py").write_text(
        "from service.features.provisioning import lists\n"
    )
    other = " ".join(lint(packages).stdout.split())
    assert "A feature imports no other feature BROKEN" in other
    (packages / "service" / "store" / "runs.py").write_text(
        "from service.features.shift_notes import tables\n"
    )
    core = " ".join(lint(packages).stdout.split())
    assert "each package says where it stands BROKEN" in core
