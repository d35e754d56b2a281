"""The rationalisation sheet on the command line, whether the service runs or not."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from service.store import Store

pytestmark = pytest.mark.wires

Cli = Callable[..., "subprocess.CompletedProcess[str]"]
Configure = Callable[..., Path]


@pytest.fixture
def config(configure: Configure, asset: str) -> str:
    return str(configure(asset))


def test_a_sheet_goes_out_and_comes_in(cli: Cli, config: str, tmp_path: Path) -> None:
    done = cli("alarms", "export", "sheet.csv", "-c", config)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "sheet.csv").read_text(encoding="utf-8")
    assert text.startswith("\ufeffasset,tag,kind,level,")
    same = cli("alarms", "import", "sheet.csv", "-c", config, "--comment", "same", "--json")
    assert json.loads(same.stdout)["changed"] == 0, same.stderr
    old = next(line for line in text.splitlines() if ",measured limit,alarm," in line)
    setpoint = old.split(",")[6]
    assert setpoint
    new = old.replace(f",{setpoint},°C,", ",99.5,°C,", 1)
    assert new != old
    (tmp_path / "edited.csv").write_text(text.replace(old, new), encoding="utf-8")
    tried = cli("alarms", "import", "edited.csv", "-c", config, "--dry-run")
    assert f"setpoint: {float(setpoint)} -> 99.5" in tried.stdout, tried.stdout + tried.stderr
    assert "1 alarms would change" in tried.stdout
    assert cli("alarms", "import", "edited.csv", "-c", config).returncode == 2
    done = cli("alarms", "import", "edited.csv", "-c", config, "--comment", "review")
    assert done.returncode == 0, done.stderr
    with Store.open("", tmp_path / "data") as store:
        (change,) = store.alarm_overlays.history(10).items
        assert (change.after, change.comment) == ({"setpoint": 99.5}, "review")
        (line,) = store.audit.page().items
        assert (line.action, line.detail.startswith("review; ")) == ("alarm_settings.import", True)
    told = [line for line in cli("check", "-c", config).stderr.splitlines() if "measured" in line]
    assert told == [
        "bearing-twin: warning: motor-1: measured limit t_inner_ring_c alarm: setpoint is 99.5, "
        "changed from 105.0"
    ]
    out = cli("alarms", "export", "-c", config)
    assert ",99.5,°C," in out.stdout


def test_a_mistake_names_line_and_column_and_changes_nothing(
    cli: Cli, config: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.csv").write_text(
        "asset,tag,kind,level,setpoint\n"
        "motor-1,t_inner_ring_c,measured limit,warning,40\n"
        "motor-1,t_inner_ring_c,measured limit,alarm,warm\n"
    )
    done = cli("alarms", "import", "bad.csv", "-c", config, "--comment", "try")
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "bearing-twin: bad.csv: row 3, setpoint: 'warm': expected a number",
        "bearing-twin: bad.csv: nothing is changed",
    ]
    with Store.open("", tmp_path / "data") as store:
        assert store.alarm_overlays.revision() == 0
