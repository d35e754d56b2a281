"""What `serve` refuses, `check` refuses too: a list of configurations that cannot be used."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest
from site_files import asset_text

ASSET: Final = asset_text("motor-1")
OTHERS: Final = asset_text("motor-1", ("speed_rpm", "load_n"))
SERVICE: Final = '[service]\ndata_dir = "data"\nport = 24999\n'
DBC: Final = Path(__file__).parents[2] / "adapters" / "bench.dbc"
HOOK: Final = '[[notifications]]\nid = "a"\nkind = "webhook"\nurl = "http://127.0.0.1:1/"\n'
OPCUA: Final = 'driver = "opcua"\nendpoint = "opc.tcp://127.0.0.1:1/x"'

FULL: Final = {
    "not TOML": "[[[",
    "no text": "\0",
    "unknown section": f"[nope]\na = 1\n{ASSET}",
    "data directory is a file": f'[service]\ndata_dir = "site.toml"\n{ASSET}',
    "data directory in a file": f'[service]\ndata_dir = "site.toml/data"\n{ASSET}',
    "data directory in no file system": f'[service]\ndata_dir = "/proc/nowhere/x"\n{ASSET}',
    "another database": f'{SERVICE}database_url = "mysql://root@db/x"\n{ASSET}',
    "no database": f'{SERVICE}database_url = "postgres"\n{ASSET}',
    "open without a key": f'{SERVICE}host = "0.0.0.0"\n{ASSET}',
    "no host": f'{SERVICE}host = "not a host"\n{ASSET}',
    "no port": f"[service]\nport = 99999\n{ASSET}",
    "no spool": f"{SERVICE}spool_mib = 0\n{ASSET}",
    "an asset twice": SERVICE + ASSET + ASSET,
    "no such bearing": SERVICE + ASSET.replace("6311", "9999"),
    "no such template": SERVICE + ASSET.replace("low_risk", 'template = "x"\nlow_risk'),
    "no such network": SERVICE + ASSET.replace("low_risk", 'network = "x"\nlow_risk'),
}
BESIDE_AN_ASSET: Final = {
    "limits that are inverted": "[assets.limits]\nt_inner_ring_c = { warning = 90, alarm = 80 }",
    "limits of no channel": "[assets.limits]\nt_nope_c = { warning = 70, alarm = 80 }",
    "alarms of no kind": "[assets.alarms.nope]\non_delay_s = 1",
    "controller without a source": '[assets.controller]\nsource = "x"',
    "certificate missing": '[tls]\ncertificate = "a.pem"\nkey = "b.pem"',
    "certificate that is none": '[tls]\ncertificate = "site.toml"\nkey = "site.toml"',
    "OPC UA certificate missing": (
        '[opcua]\nenabled = true\ncertificate = "a.der"\nprivate_key = "b.pem"'
    ),
    "OPC UA on the same port": '[opcua]\nenabled = true\nendpoint = "opc.tcp://127.0.0.1:24999/x"',
    "Modbus server on the same port": "[modbus_server]\nenabled = true\nport = 24999",
    "broker without a host": '[mqtt]\nenabled = true\nhost = ""',
    "broker's authority missing": '[mqtt]\nenabled = true\ntls = true\nca_file = "x.pem"',
    "no such publisher": "[publishers.nope]\na = 1",
    "a clock that stands": "[clock]\nrate = 0",
    "no workers": "[jobs]\nworkers = 0",
    "audit trail of a week": "[retention]\naudit_days = 7",
    "hook of another scheme": HOOK.replace("http:", "ftp:"),
    "escalation to none": f'{HOOK}escalation = [{{ to = "b", after_min = 60 }}]',
    "mail without a server": '[[notifications]]\nid = "a"\nkind = "email"\nto = ["a@example.com"]',
    "hook without its secret": f'{HOOK}secret_variable = "NOPE_X"',
    "no log-ins": "[security]\nfailed_logins_per_minute = 0",
    "fleet without a bus": '[fleet]\nnats_url = "http://127.0.0.1:1"',
}
#: What a source has, and the channel that it is to give.
SOURCES: Final = {
    "no such driver": ('driver = "profibus"', "register = 1"),
    "DBC file missing": ('driver = "can"\nchannel = "x"\ndbc = "no.dbc"', 'message = "M"'),
    "DBC file that is none": ('driver = "can"\nchannel = "x"\ndbc = "site.toml"', 'message = "M"'),
    "no such message": (
        f'driver = "can"\ninterface = "virtual"\nchannel = "x"\ndbc = "{DBC}"',
        'message = "M", signal = "S"',
    ),
    "no such bus": (
        f'driver = "can"\ninterface = "nope"\nchannel = "x"\ndbc = "{DBC}"',
        'message = "Bench", signal = "Speed"',
    ),
    "recording missing": ('driver = "replay"\nfile = "no.csv"', 'column = "a"'),
    "recording that is none": ('driver = "replay"\nfile = "site.toml"', 'column = "a"'),
    "no such column": ('driver = "replay"\nfile = "run.csv"', 'column = "b"'),
    "password missing": (
        f'{OPCUA}\nuser = "a"\npassword_variable = "NOPE_X"',
        'node = "ns=2;s=a"',
    ),
    "no node": (OPCUA, 'node = "TIC101"'),
}


def configurations() -> dict[str, str]:
    found = dict(FULL)
    found |= {name: f"{SERVICE}{ASSET}\n{text}\n" for name, text in BESIDE_AN_ASSET.items()}
    for name, (source, keys) in SOURCES.items():
        channel = f't_inner_ring_c = {{ source = "s", {keys} }}\n'
        found[name] = f'{SERVICE}\n[[sources]]\nname = "s"\n{source}\n{OTHERS}{channel}'
    return found


@pytest.mark.parametrize("name", configurations())
def test_check_refuses_what_serve_refuses(
    name: str, cli: Callable[..., "subprocess.CompletedProcess[str]"], tmp_path: Path
) -> None:
    text = configurations()[name]
    (tmp_path / "site.toml").write_text(text)
    (tmp_path / "run.csv").write_text("time_s,a\n0,1\n1,2\n")
    served = cli("serve", "-c", "site.toml")
    checked = cli("check", "-c", "site.toml", "--json")
    assert served.returncode == 2, served.stderr
    assert checked.returncode == 2, checked.stderr
    assert "Traceback" not in served.stderr
    mark = "bearing-twin: "
    said = [line for line in served.stderr.splitlines() if line.startswith(mark)][-1]
    said = said.removeprefix(mark).removeprefix("site.toml: ")
    errors = json.loads(checked.stdout)["errors"] if checked.stdout else [checked.stderr]
    assert any(said[:40] in line for line in errors), (said, errors)
